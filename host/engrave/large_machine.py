"""The engraver with room for large drawings, for the scripts of this folder."""

import os
import re

MACHINE = os.path.join(os.path.dirname(os.path.abspath(__file__)), "../../machines/engraver.toml")

# Strokes of pose, joint and hard stops of x and y: the machine file of the tree and the large one.
WIDER = (
    ("low_mm = 0.0", "low_mm = -100.0", 2),
    ("low_mm = -4.0", "low_mm = -104.0", 2),
    ("low = -6.0", "low = -106.0", 2),
    ("high_mm = 110.0", "high_mm = 1200.0", 1),
    ("high_mm = 250.0", "high_mm = 1200.0", 1),
    ("high_mm = 112.0", "high_mm = 1204.0", 1),
    ("high_mm = 252.0", "high_mm = 1204.0", 1),
    ("high = 114.0", "high = 1206.0", 1),
    ("high = 254.0", "high = 1206.0", 1),
)


def write(path):
    """Writes `machines/engraver.toml` with an area of 1200 x 1200 mm."""
    text = open(MACHINE).read()
    for old, new, count in WIDER:
        # A machine file that has changed would give refusals of drawings, not of the machine.
        text, found = re.subn(rf"^{re.escape(old)}\b", new, text, flags=re.MULTILINE)
        if found != count:
            raise SystemExit(f"machines/engraver.toml has {found} lines '{old}', not {count}: "
                             "correct host/engrave/large_machine.py")
    with open(path, "w") as out:
        out.write(text)
