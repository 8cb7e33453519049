"""What acts on the train: traction, brakes, doors, each reacting to its command and to silence."""
