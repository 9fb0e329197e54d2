#!/usr/bin/env python3
"""Compares the pockets of `haptimill engrave` with the polygons of shapely.

Needs the Python package shapely:
    python3 host/engrave/pockets.py COMMAND DRAWING ...

Every drawing is cleared in contours, in zig-zag rows and in one-way rows, by a tool of a sixtieth of
its larger side. The area to clear is that between the closed paths of the program of
`--operation outline`. What the tool sweeps is the union of the buffered cuts. Uncut is the part that
the tool can reach, the area shrunk and grown by its radius, and that no cut sweeps. Over is what is
swept farther than 2 um beyond the area. Drawings that `haptimill engrave` refuses are named.

The script ends with exit code 1 where uncut or over is above 0.02 % of the area, and where nothing
was compared.
"""

import math
import os
import subprocess
import sys
import tempfile

import large_machine
from program import cuts
from shapely import make_valid
from shapely.geometry import LineString, Polygon
from shapely.ops import unary_union

MOST_PERCENT = 0.02
UNITS = ("1", "0.1", "0.01", "10")
CLEARINGS = ("contour", "zigzag", "one-way")


def area_of(paths):
    """The area between closed paths, and their number."""
    closed = [path for path in paths if len(path) > 3 and math.dist(path[0], path[-1]) < 2e-3]
    area = Polygon()
    for path in closed:
        area = area.symmetric_difference(make_valid(Polygon(path)))
    return area, len(closed)


def compare(command, drawing, folder):
    """Prints a row for each way to clear a drawing; returns the largest percentage of each."""
    name, program = os.path.basename(drawing), os.path.join(folder, "job.ngc")
    options = ["--origin", "lower-left", "--skip-text", "--machine", os.path.join(folder, "machine.toml")]

    def engrave(*more):
        words = [command, "engrave", drawing, *options, "-o", program, *more]
        return subprocess.run(words, capture_output=True, text=True)

    for unit in UNITS:
        outline = engrave("--unit", unit, "--operation", "outline", "--side", "on")
        if outline.returncode == 0:
            break
    else:
        print(f"{name}: {outline.stderr.strip().splitlines()[-1]}")
        return []
    area, count = area_of(cuts(program))
    if not count:
        print(f"{name}: no closed path")
        return []
    low_x, low_y, high_x, high_y = area.bounds
    radius = round(max(high_x - low_x, high_y - low_y) / 60.0, 2) / 2.0
    worst = []
    for clearing in CLEARINGS:
        done = engrave("--unit", unit, "--operation", "pocket", "--clear", clearing, "--tool", str(2 * radius))
        if done.returncode:
            print(f"{name}: {clearing}: {done.stderr.strip().splitlines()[-1]}")
            continue
        swept = unary_union([LineString(cut).buffer(radius, 32) for cut in cuts(program)])
        reach = area.buffer(-1.0005 * radius, 32).buffer(radius, 32)
        uncut = 100.0 * reach.difference(swept).area / area.area
        over = 100.0 * swept.difference(area.buffer(2e-3)).area / area.area
        worst.append(max(uncut, over))
        print(f"{name}: {clearing}: {count} closed paths, {area.area:.2f} mm^2, tool {2 * radius:.2f} mm: "
              f"uncut {uncut:.4f} %, over {over:.4f} %", flush=True)
    return worst


def main():
    command, *drawings = sys.argv[1:]
    with tempfile.TemporaryDirectory() as folder:
        large_machine.write(os.path.join(folder, "machine.toml"))
        found = [worst for drawing in drawings for worst in compare(command, drawing, folder)]
    if not found:
        sys.exit("no drawing was compared")
    print(f"{len(found)} programs: at most {max(found):.4f} %")
    sys.exit(max(found) > MOST_PERCENT)


main()
