"""What a node says of its own defects."""

from ladar_volume.nodes.watch.defect_reports import AGAIN_S, Defects


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
    assert defects.told(first, 5.0) == (
        f"ZeroDivisionError in test_defects.py:{first.__traceback__.tb_next.tb_lineno}: "
        "division by zero"
    )
    assert defects.told(second, 5.0) is None and defects.told(second, 4.9 + AGAIN_S) is None
    assert "KeyError in test_defects.py" in defects.told(caught(lambda: {}["other place"]), 6.0)
    assert defects.told(second, 5.0 + AGAIN_S).endswith("division by zero (3 times)")
    assert defects.told(ValueError("no frames"), 0.0) == "ValueError in unknown place: no frames"
