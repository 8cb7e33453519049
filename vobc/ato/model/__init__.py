"""Operation's models of its train: brake, adhesion and motion, and predictions from them."""
