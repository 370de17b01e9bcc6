"""Numbers in names: what is a sign, what a decimal, and what only stands between."""

from decimal import Decimal

import pytest

from lf_flame.formats.view_files.names import split_numbers


@pytest.mark.parametrize(
    ("names", "numbers"),
    [
        (["frame2", "frame10"], [(2,), (10,)]),
        (["pos_-40_-0.5", "pos_-8_16"], [(-40, -0.5), (-8, 16)]),
        (["lf_-2_-1", "lf_+2_1"], [(-2, -1), (2, 1)]),
        (["y0.00_x0", "y5.48_x12"], [(0, 0), (5.48, 12)]),
        (["y-4", "y0", "y4"], [(-4,), (0,), (4,)]),
        (["y-4.5", "y+0.0"], [(-4.5,), (0,)]),
        (["y-5x-2", "y-4x+2"], [(-5, -2), (-4, 2)]),
        (["view-01-02", "view-11-12"], [(1, 2), (11, 12)]),
        (["2024-01-05", "2024-02-15"], [(2024, 1, 5), (2024, 2, 15)]),
        (["-1.5", "-0.25"], [(-1.5,), (-0.25,)]),
        (["0", "0.5", "1.5"], [(0,), (0.5,), (1.5,)]),
        (["0", "0.50", "12.25"], [(0,), (0.5,), (12.25,)]),
        (["1.9", "1.10"], [(1, 9), (1, 10)]),
        (["a.1.02.03", "a.1.02.10"], [(1, 2, 3), (1, 2, 10)]),
        (["frame.0002", "frame.0010"], [(2,), (10,)]),
        ([f"{10**19}", f"{10**19 + 1}"], [(10**19,), (10**19 + 1,)]),
    ],
    ids=lambda value: str(value[0]),
)
def test_numbers_are_read_and_sort(names, numbers):
    parts = split_numbers(names)
    found = [part[1::2] for part in parts]
    assert found == [tuple(Decimal(str(n)) for n in one) for one in numbers]
    turned = dict(zip(names[::-1], split_numbers(names[::-1]), strict=True))
    assert sorted(turned, key=turned.__getitem__) == sorted(
        names, key=dict(zip(names, numbers, strict=True)).__getitem__
    )


def test_the_text_between_the_numbers_is_kept():
    assert split_numbers(["a-1 b_-2c", "none", ""]) == [
        ("a-", Decimal(1), " b_", Decimal(-2), "c"),
        ("none",),
        ("",),
    ]


def test_names_of_several_kinds_sort_together():
    names = ["b1", "a10", "a9", "a", "3", "a9-2"]
    parts = dict(zip(names, split_numbers(names), strict=True))
    assert sorted(names, key=parts.__getitem__) == ["3", "a", "a9", "a9-2", "a10", "b1"]
