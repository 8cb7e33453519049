"""Reports of a late or weak brake are read from the bus, with their value and unit."""

from can_dbc.codec import Encoder
from can_dbc.vobc import EventKind, VobcEvent
from metro_hil.metrics.brake_reports import BrakeReports


def test_each_report_is_recorded_and_no_other_event() -> None:
    reports, encoder = BrakeReports(), Encoder([VobcEvent])
    for number, (kind, value) in enumerate(
        [(EventKind.BRAKE_WEAK, 78), (EventKind.TAG_MISSED, 1), (EventKind.BRAKE_LATE, 3000)], 1
    ):
        for can_id, payload in encoder.encode(VobcEvent(kind, value, number, 0, 0)):
            reports.frame(number * 1_000_000_000, can_id, payload)

    assert [tuple(report) for report in reports.found] == [
        (1.0, "the controller reports a weak brake: 78 % of the demand"),
        (3.0, "the controller reports a late brake: dead time 3000 ms or more"),
    ]
