"""The rest of the railway as a train receives it by radio."""
