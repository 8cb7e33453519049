"""Processor time that a process and its ended children have used."""

import resource


def processor_time_s() -> float:
    """User and system time until now, s; a child counts once it has ended and was waited for."""
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(each.ru_utime + each.ru_stime for each in used)
