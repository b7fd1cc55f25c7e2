"""The comparison of printed texts sees words and digits, and no run times."""

from tests.guides.printed import differences

SHOWN = """
rig
  run    1.13e+08 lane-steps in 10.1 s (89.8 ns each), compiled in 8.5 s, 2 devices
  gap         0.03808°  0.01312 … 0.06345
  cases  9150 ok
"""


def test_what_is_the_same():
    for old, new in (
        ("10.1 s (89.8 ns each), compiled in 8.5 s, 2", "7 s (5 ns each), compiled in 12 s, 16"),
        ("0.03808°", "0.03810°"),
        ("  0.01312", "   0.01313"),
        ("9150 ok", "9150 ok\nand more below it"),
    ):
        assert differences(SHOWN, SHOWN.strip("\n").replace(old, new)) == []


def test_what_is_not():
    for old, new in (
        ("0.03808°", "0.03811°"),
        ("0.03808°", "-0.03808°"),
        ("0.03808°", "0.03808 rad"),
        ("9150", "9151"),
        ("1.13e+08", "1.16e+08"),
        ("  cases  9150 ok", ""),
        ("rig\n", ""),
    ):
        assert differences(SHOWN, SHOWN.strip("\n").replace(old, new)) != []


def test_drawn_numbers_differ_by_a_share():
    other = SHOWN.strip("\n").replace("0.06345", "0.06400")
    assert differences(SHOWN, other) != [] and differences(SHOWN, other, share=0.01) == []
