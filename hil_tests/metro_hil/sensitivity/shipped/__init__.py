"""The shipped mutations of the controller, one file for each area; `hil sensitivity` tries them."""
