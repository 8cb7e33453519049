"""What the train measures of itself and of the track."""
