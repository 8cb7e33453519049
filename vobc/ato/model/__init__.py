"""What operation believes of its train: brake, adhesion, motion, and what it predicts from that."""
