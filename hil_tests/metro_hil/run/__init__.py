"""Runs in virtual time: the lockstep bench, a case on it, cases that share their beginning."""
