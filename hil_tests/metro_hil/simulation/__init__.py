"""Trains, arbiters and wayside on one machine in virtual time, under every fault of a network."""
