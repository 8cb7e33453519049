"""Several trains on one network in virtual time, each of which makes the trips of a service."""
