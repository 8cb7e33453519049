"""Plausibility checks: the range of every field of every message. Pure."""

from typing import Final

from zenoh_config.messages import (
    MAX_ADDRESS,
    RESTRICTIONS_MAX,
    WAYSIDE,
    Message,
    MovementAuthority,
    PositionReport,
    TrainOrders,
    TrainStatus,
)

MAX_CHAINAGE_M: Final = 1.0e6
MAX_SPEED_MPS: Final = 200.0
MAX_CODE: Final = 255
MAX_NUMBER: Final = 2**32 - 1
MAX_STAMP_NS: Final = 2**63 - 1
MAX_VERSION: Final = 2**64 - 1


def problem_of(message: Message) -> str:
    """Describe the first implausible field; empty without one. The comparisons also catch NaN."""
    if isinstance(message, PositionReport):
        return _report_problem(message)
    if isinstance(message, MovementAuthority):
        return _authority_problem(message)
    if isinstance(message, TrainStatus):
        return _status_problem(message)
    return _orders_problem(message)


def _report_problem(report: PositionReport) -> str:
    if not WAYSIDE < report.train <= MAX_ADDRESS:
        return f"train {report.train} is not in 1..{MAX_ADDRESS}"
    if not WAYSIDE <= report.destination <= MAX_ADDRESS:
        return f"destination {report.destination} is not in 0..{MAX_ADDRESS}"
    if not -MAX_SPEED_MPS <= report.speed_mps <= MAX_SPEED_MPS:
        return f"speed_mps {report.speed_mps} is not in ±{MAX_SPEED_MPS}"
    if not report.rear_min_m <= report.front_min_m <= report.front_max_m:
        return (
            f"rear_min_m {report.rear_min_m}, front_min_m {report.front_min_m} and "
            f"front_max_m {report.front_max_m} are not in this order"
        )
    if report.rear_min_m < -MAX_CHAINAGE_M or report.front_max_m > MAX_CHAINAGE_M:
        return (
            f"rear_min_m {report.rear_min_m} or front_max_m {report.front_max_m} is off every line"
        )
    if not 0 <= report.parameters <= MAX_VERSION:
        return f"parameters {report.parameters} is not in 0..{MAX_VERSION}"
    return _number_problem(report.boot, report.sequence, report.stamp_ns)


def _authority_problem(authority: MovementAuthority) -> str:
    if not WAYSIDE < authority.train <= MAX_ADDRESS:
        return f"train {authority.train} is not in 1..{MAX_ADDRESS}"
    if not WAYSIDE <= authority.source <= MAX_ADDRESS:
        return f"source {authority.source} is not in 0..{MAX_ADDRESS}"
    if not 0 <= authority.term <= MAX_NUMBER:
        return f"term {authority.term} is not in 0..{MAX_NUMBER}"
    if not 0 <= authority.echo_stamp_ns <= MAX_STAMP_NS:
        return f"echo_stamp_ns {authority.echo_stamp_ns} is not in 0..{MAX_STAMP_NS}"
    if not -MAX_CHAINAGE_M <= authority.end_m <= MAX_CHAINAGE_M:
        return f"end_m {authority.end_m} is off every line"
    rear_m = authority.rear_m
    if rear_m is not None and not -MAX_CHAINAGE_M <= rear_m <= authority.end_m:
        return f"rear_m {rear_m} is off every line or beyond end_m {authority.end_m}"
    if not 0 <= authority.parameters <= MAX_VERSION:
        return f"parameters {authority.parameters} is not in 0..{MAX_VERSION}"
    return _number_problem(authority.boot, authority.sequence, authority.stamp_ns)


def _status_problem(status: TrainStatus) -> str:
    if not WAYSIDE < status.train <= MAX_ADDRESS:
        return f"train {status.train} is not in 1..{MAX_ADDRESS}"
    if not WAYSIDE <= status.destination <= MAX_ADDRESS:
        return f"destination {status.destination} is not in 0..{MAX_ADDRESS}"
    for name in ("mode", "supervision", "cause"):
        if not 0 <= getattr(status, name) <= MAX_CODE:
            return f"{name} {getattr(status, name)} is not in 0..{MAX_CODE}"
    if not -MAX_CHAINAGE_M <= status.front_m <= MAX_CHAINAGE_M:
        return f"front_m {status.front_m} is off every line"
    if not 0 <= status.emergency_number <= MAX_NUMBER:
        return f"emergency_number {status.emergency_number} is not in 0..{MAX_NUMBER}"
    return _number_problem(status.boot, status.sequence, status.stamp_ns)


def _orders_problem(orders: TrainOrders) -> str:
    if not WAYSIDE < orders.train <= MAX_ADDRESS:
        return f"train {orders.train} is not in 1..{MAX_ADDRESS}"
    if not WAYSIDE <= orders.source <= MAX_ADDRESS:
        return f"source {orders.source} is not in 0..{MAX_ADDRESS}"
    if not 0 <= orders.echo_stamp_ns <= MAX_STAMP_NS:
        return f"echo_stamp_ns {orders.echo_stamp_ns} is not in 0..{MAX_STAMP_NS}"
    if not 0 <= orders.releases <= MAX_NUMBER:
        return f"releases {orders.releases} is not in 0..{MAX_NUMBER}"
    if not 0 <= orders.released_emergency <= MAX_NUMBER:
        return f"released_emergency {orders.released_emergency} is not in 0..{MAX_NUMBER}"
    if len(orders.restrictions) > RESTRICTIONS_MAX:
        return f"{len(orders.restrictions)} restrictions, at most {RESTRICTIONS_MAX} fit"
    for each in orders.restrictions:
        if not -MAX_CHAINAGE_M <= each.start_m <= each.end_m <= MAX_CHAINAGE_M:
            return f"restriction from {each.start_m} m to {each.end_m} m is no stretch of a line"
        if not 0.0 < each.limit_mps <= MAX_SPEED_MPS:
            return f"restriction to {each.limit_mps} m/s is not in 0..{MAX_SPEED_MPS}"
    return _number_problem(orders.boot, orders.sequence, orders.stamp_ns)


def _number_problem(boot: int, sequence: int, stamp_ns: int) -> str:
    if not 0 <= boot <= MAX_NUMBER:
        return f"boot {boot} is not in 0..{MAX_NUMBER}"
    if not 0 <= sequence <= MAX_NUMBER:
        return f"sequence {sequence} is not in 0..{MAX_NUMBER}"
    if not 0 <= stamp_ns <= MAX_STAMP_NS:
        return f"stamp_ns {stamp_ns} is not in 0..{MAX_STAMP_NS}"
    return ""
