#!/usr/bin/env python3
"""Compares the lengths that `haptimill engrave` cuts with those that other programs read.

Needs the Python packages ezdxf (for DXF) and vpype (for SVG):
    python3 host/engrave/lengths.py COMMAND DRAWING ...

A drawing is cut once along its paths, with the lower left corner at the origin, without texts, and
a DXF with the first of the units 1, 0.1, 0.01 and 10 mm with which it fits 1200 x 1200 mm. Lengths
are in units of the DXF, and in mm of the SVG. The other length is that of the same entities in
ezdxf, flattened within 0.001 units, or that of vpype. What one of both programs leaves out on
purpose (hidden layers, fills, frozen blocks) is a difference: the last column has the notices and
refusals of `haptimill engrave`. Refused drawings have no lengths. The script ends with exit code 1
where every drawing is refused.
"""

import math
import os
import re
import subprocess
import sys
import tempfile

import large_machine
from program import cuts

UNITS = (1.0, 0.1, 0.01, 10.0)
PATHS = {"LINE", "ARC", "CIRCLE", "LWPOLYLINE", "POLYLINE", "ELLIPSE", "SPLINE", "SOLID", "TRACE"}


def of_dxf(drawing):
    """Length of the visible entities in model space, in units of the drawing."""
    from ezdxf import disassemble, path, recover

    document, _ = recover.readfile(drawing)
    total = 0.0
    for entity in disassemble.recursive_decompose(document.modelspace()):
        layer = document.layers.get(entity.dxf.layer) if entity.dxf.layer in document.layers else None
        if entity.dxftype() not in PATHS or entity.dxf.get("invisible", 0) or (
                layer and (layer.is_off() or layer.is_frozen())):
            continue
        points = list(path.make_path(entity).flattening(0.001))
        total += sum(a.distance(b) for a, b in zip(points, points[1:]))
    return total


def of_svg(drawing):
    """Length of all paths, mm."""
    vpype = os.path.join(os.path.dirname(sys.executable), "vpype")
    done = subprocess.run([vpype, "read", "-q", "0.005mm", drawing, "stat"], capture_output=True, text=True)
    found = re.search(r"  Length: ([\d.]+)", done.stdout.split("Totals")[-1])
    return float(found[1]) * 25.4 / 96 if found else math.nan


def compare(command, drawing, folder):
    """Prints the row of a drawing; returns whether it was compared."""
    name, program = os.path.basename(drawing), os.path.join(folder, "job.ngc")
    is_dxf = drawing.lower().endswith(".dxf")
    options = ["--origin", "lower-left", "--skip-text", "--machine", os.path.join(folder, "machine.toml")]
    for unit in UNITS if is_dxf else (1.0,):
        words = [command, "engrave", drawing, *options, "-o", program]
        done = subprocess.run(words + (["--unit", str(unit)] if is_dxf else []), capture_output=True, text=True)
        if done.returncode == 0:
            break
    notices = [line for line in done.stderr.splitlines() if line.strip()]
    said = notices[0][:100] if notices else ""
    if done.returncode:
        print(f"| {name} | | | refused: {(notices or [''])[-1][:100]} |", flush=True)
        return False
    paths = cuts(program)
    ours = sum(math.dist(a, b) for path in paths for a, b in zip(path, path[1:])) / unit
    theirs = of_dxf(drawing) if is_dxf else of_svg(drawing)
    off = 100.0 * (ours / theirs - 1.0) if theirs else math.nan
    print(f"| {name} | {ours:.2f} | {theirs:.2f} | {off:+.3f} %; {len(notices)} notices {said} |", flush=True)
    return True


def main():
    command, *drawings = sys.argv[1:]
    print("| drawing | length | length, other program | difference; notices |")
    print("| --- | ---: | ---: | --- |")
    with tempfile.TemporaryDirectory() as folder:
        large_machine.write(os.path.join(folder, "machine.toml"))
        compared = [compare(command, drawing, folder) for drawing in drawings]
    if not any(compared):
        sys.exit("no drawing was compared")


main()
