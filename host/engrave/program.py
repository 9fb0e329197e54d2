"""The cuts of a part program of `haptimill engrave`, for the scripts of this folder."""

import math
import re


def arc(start, end, i, j, clockwise):
    """Points of an arc after its start; ends at one angle are a whole circle."""
    centre, radius = (start[0] + i, start[1] + j), math.hypot(i, j)
    angles = [math.atan2(at[1] - centre[1], at[0] - centre[0]) for at in (start, end)]
    sweep = (angles[0] - angles[1] if clockwise else angles[1] - angles[0]) % math.tau
    sweep = sweep if sweep > 1e-9 else math.tau
    count = max(2, int(sweep / 0.03) + 1)
    turns = [angles[0] + (-sweep if clockwise else sweep) * k / count for k in range(1, count)]
    return [(centre[0] + radius * math.cos(a), centre[1] + radius * math.sin(a)) for a in turns] + [end]


def cuts(path):
    """The polylines that the tool follows below the surface."""
    at, height, code, cut, found = (0.0, 0.0), 1.0, 0, [], []
    for line in open(path):
        line = line.split(";")[0]
        head = re.match(r"G([0-3])\b", line)
        if not head:
            continue
        code = int(head[1])
        words = {letter: float(value) for letter, value in re.findall(r"([XYZIJ])(-?[\d.]+)", line)}
        to = (words.get("X", at[0]), words.get("Y", at[1]))
        below = height < 0.0 and words.get("Z", height) < 0.0 and code > 0
        if below and (to != at or code > 1):
            cut = cut or [at]
            cut += [to] if code == 1 else arc(at, to, words.get("I", 0.0), words.get("J", 0.0), code == 2)
        elif not below:
            found += [cut] if len(cut) > 1 else []
            cut = []
        at, height = to, words.get("Z", height)
    return found + ([cut] if len(cut) > 1 else [])
