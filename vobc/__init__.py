"""The on-board controller: what it believes, decides and says. It knows the world by wires only."""
