"""Benchmarks behind `make bench*`: each figure beside a peer or a limit in the same run."""
