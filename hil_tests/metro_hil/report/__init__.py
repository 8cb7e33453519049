"""What a person is shown of a run: a table and a plot."""
