"""What a node says of its own defects."""

from ladar_volume.nodes.watch.defect_reports import REPORT_INTERVAL_S, Defects


def caught(what):
    try:
        what()
    except Exception as error:
        return error
    return None


def test_each_place_once_a_minute_with_how_often():
    def one():
        return 1 / 0

    defects = Defects()
    first, second = (caught(one) for _ in range(2))
    assert defects.report_text(first, 5.0) == (
        f"ZeroDivisionError in test_defects.py:{first.__traceback__.tb_next.tb_lineno}: "
        "division by zero"
    )
    assert (
        defects.report_text(second, 5.0) is None
        and defects.report_text(second, 4.9 + REPORT_INTERVAL_S) is None
    )
    assert "KeyError in test_defects.py" in defects.report_text(
        caught(lambda: {}["other place"]), 6.0
    )
    assert defects.report_text(second, 5.0 + REPORT_INTERVAL_S).endswith(
        "division by zero (3 times)"
    )
    assert (
        defects.report_text(ValueError("no frames"), 0.0)
        == "ValueError in unknown place: no frames"
    )
