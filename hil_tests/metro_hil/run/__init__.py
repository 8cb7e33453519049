"""Runs in virtual time: the lockstep bench, single cases, and cases that share their beginning."""
