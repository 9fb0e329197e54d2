#!/usr/bin/env python3
"""Compares the order of `haptimill engrave` with `vpype linesort` and with LKH (`elkai`).

Needs Python packages vpype and elkai, and a release build:
    cargo build --release -p haptimill
    python3 host/engrave/compare.py target/release/haptimill [--lkh]

Every drawing is an SVG of lines; the first one is a dot at the origin, where both programs start.
Air is the length of the lifted moves from the origin through all lines, without the way back, read
from the results: the SVG of vpype, the part program of haptimill. The column "with the way back"
has the way back to the origin, which every job has. CPU is that of the whole process.

The script ends with exit code 1 where a bound is not kept: on random lines and lettering every
order is shorter than that of vpype, by 20 % in the median, and on clusters, all in no more CPU
time; on rows and squares none is longer, on a grid of dashes none with the way back; no tour is
more than 3 % longer than that of LKH.
"""

import math
import os
import random
import re
import resource
import statistics
import subprocess
import sys
import tempfile

import large_machine

HAPTIMILL = sys.argv[1]
PAGE = 1000.0


def random_lines(count, seed):
    """Short lines at random places."""
    rnd = random.Random(seed)
    lines = []
    for _ in range(count):
        x, y, a = rnd.uniform(10, 990), rnd.uniform(10, 990), rnd.uniform(0, math.tau)
        r = rnd.uniform(0.5, 8)
        lines.append([(x, y), (x + r * math.cos(a), y + r * math.sin(a))])
    return lines


STROKES = {  # letters of single strokes on a 4 x 6 grid
    "A": [[(0, 0), (2, 6), (4, 0)], [(1, 2), (3, 2)]],
    "E": [[(4, 0), (0, 0), (0, 6), (4, 6)], [(0, 3), (3, 3)]],
    "G": [[(4, 5), (3, 6), (1, 6), (0, 5), (0, 1), (1, 0), (3, 0), (4, 1), (4, 3), (2, 3)]],
    "H": [[(0, 0), (0, 6)], [(4, 0), (4, 6)], [(0, 3), (4, 3)]],
    "I": [[(2, 0), (2, 6)]],
    "L": [[(0, 6), (0, 0), (4, 0)]],
    "N": [[(0, 0), (0, 6), (4, 0), (4, 6)]],
    "R": [[(0, 0), (0, 6), (3, 6), (4, 5), (4, 4), (3, 3), (0, 3)], [(2, 3), (4, 0)]],
    "T": [[(0, 6), (4, 6)], [(2, 0), (2, 6)]],
    "X": [[(0, 0), (4, 6)], [(0, 6), (4, 0)]],
}


def lettering(count, seed):
    """Letters in lines of text, until there are that many segments."""
    rnd = random.Random(seed)
    lines, segments = [], 0
    columns = max(10, int(math.sqrt(count / 2)))
    pitch = 980.0 / columns
    k = 0
    while segments < count:
        x, y = 10 + (k % columns) * pitch, 985 - (k // columns) * pitch * 1.6
        k += 1
        if rnd.random() < 0.15:
            continue
        for stroke in STROKES[rnd.choice(sorted(STROKES))]:
            scale = pitch / 6
            lines.append([(x + px * scale, y + py * scale) for px, py in stroke])
            segments += len(stroke) - 1
    rnd.shuffle(lines)
    return lines


def clusters(count, seed):
    """Short lines about 10 to 30 centres, as words and parts on a plate."""
    rnd = random.Random(seed)
    centres = [(rnd.uniform(50, 950), rnd.uniform(50, 950)) for _ in range(rnd.choice((10, 20, 30)))]
    lines = []
    for _ in range(count):
        x, y = (min(990, max(10, rnd.gauss(at, 15))) for at in rnd.choice(centres))
        a, r = rnd.uniform(0, math.tau), rnd.uniform(0.5, 6)
        lines.append([(x, y), (x + r * math.cos(a), y + r * math.sin(a))])
    return lines


def rows(count, _seed):
    """Rows of a hatch, all in one direction."""
    return [[(10, 10 + k * 980 / count), (900, 10 + k * 980 / count)] for k in range(count)]


def squares(count, seed):
    """Closed squares at random places."""
    rnd = random.Random(seed)
    lines = []
    for _ in range(count // 4):
        x, y, a = rnd.uniform(10, 980), rnd.uniform(10, 980), rnd.uniform(1, 8)
        lines.append([(x, y), (x + a, y), (x + a, y + a), (x, y + a), (x, y)])
    return lines


def dashes(count, _seed):
    """A grid of dashes, as a dashed hatch."""
    side = round(math.sqrt(count))
    return [[(20 + i * 960 / side, 20 + j * 960 / side), (20 + (i + 0.5) * 960 / side, 20 + j * 960 / side)]
            for j in range(side) for i in range(side)]


def write_svg(path, lines):
    with open(path, "w") as out:
        out.write('<svg xmlns="http://www.w3.org/2000/svg" width="1000mm" height="1000mm" viewBox="0 0 1000 1000">\n')
        for line in [[(0, 0), (0.001, 0)]] + lines:
            points = " ".join(f"{x:.4f},{PAGE - y:.4f}" for x, y in line)
            out.write(f'<polyline fill="none" stroke="black" points="{points}"/>\n')
        out.write("</svg>\n")


def run(arguments):
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run(arguments, capture_output=True, text=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    if done.returncode:
        sys.exit(f"{arguments}: {done.stderr}{done.stdout}")
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def length(jumps):
    return sum(math.dist(a, b) for a, b in jumps)


def air_of_svg(path):
    """Polylines in their order; y up, mm."""
    import vpype

    document = vpype.read_multilayer_svg(path, 0.01)
    mm = 96 / 25.4
    at, jumps = (0.0, 0.0), []
    for layer in document.layers.values():
        for line in layer:
            points = [(p.real / mm, PAGE - p.imag / mm) for p in (line[0], line[-1])]
            jumps.append((at, points[0]))
            at = points[1]
    return length(jumps), length(jumps + [(at, (0.0, 0.0))])


def air_of_program(path):
    at, jumps, z, word = [0.0, 0.0], [], 1.0, "G0"
    for line in open(path):
        found = dict(re.findall(r"([XYZ])(-?[\d.]+)", line.split(";")[0]))
        head = re.match(r"(G[0-3])\b", line)
        if not head:
            continue
        to = [float(found.get("X", at[0])), float(found.get("Y", at[1]))]
        z = float(found.get("Z", z))
        if head[1] == "G0" and to != at:
            jumps.append((at, to))
        at = to
    return length(jumps[:-1])  # the last one leads back to the origin


def cut(folder, lines):
    """Writes `d.ngc` for the lines, on a machine that is large enough; returns the CPU time, s."""
    drawing, ngc = os.path.join(folder, "d.svg"), os.path.join(folder, "d.ngc")
    write_svg(drawing, lines)
    machine = os.path.join(folder, "machine.toml")
    large_machine.write(machine)
    return run([HAPTIMILL, "engrave", drawing, "-o", ngc, "--machine", machine])


def compare(folder, name, lines):
    """Writes a row of the table; returns what is saved without and with the way back, in percent,
    and both CPU times."""
    drawing, sorted_svg, ngc = (os.path.join(folder, name) for name in ("d.svg", "s.svg", "d.ngc"))
    write_svg(drawing, lines)
    vpype = [os.path.join(os.path.dirname(sys.executable), "vpype")]
    read_only = run(vpype + ["read", drawing, "write", sorted_svg])
    theirs = run(vpype + ["read", drawing, "linesort", "write", sorted_svg])
    their_air, their_tour = air_of_svg(sorted_svg)
    ours = cut(folder, lines)
    our_air = air_of_program(ngc)
    saved = 100 * (1 - our_air / their_air)
    saved_tour = 100 * (1 - closed_air(ngc) / their_tour)
    print(f"| {name} | {len(lines)} | {their_air:.0f} | {our_air:.0f} | {saved:.1f} % | {saved_tour:.1f} % | "
          f"{theirs:.2f} ({read_only:.2f}) | {ours:.2f} |", flush=True)
    return saved, saved_tour, theirs, ours


def lkh(lines):
    """Air of the tour of LKH: two nodes a line, joined at no cost."""
    import elkai

    points = [(0.0, 0.0), (0.001, 0.0)] + [p for line in lines for p in (line[0], line[-1])]
    count, scale, far = len(points), 1000, 10_000_000
    matrix = [[0] * count for _ in range(count)]
    for i in range(count):
        for j in range(count):
            if i != j and i // 2 != j // 2:
                matrix[i][j] = far + round(scale * math.dist(points[i], points[j]))
    tour = elkai.DistanceMatrix(matrix).solve_tsp(runs=1)
    jumps = [(points[a], points[b]) for a, b in zip(tour, tour[1:]) if a // 2 != b // 2]
    return length(jumps)


def main():
    print("| drawing | paths | vpype linesort, mm | haptimill, mm | shorter | with the way back | "
          "vpype CPU s (without linesort) | haptimill CPU s |")
    print("| --- | ---: | ---: | ---: | ---: | ---: | ---: | ---: |")
    gains, failed = {}, []
    with tempfile.TemporaryDirectory() as folder:
        for count in (1000, 10_000, 50_000):
            for make in (random_lines, lettering, clusters, rows, squares, dashes):
                name = f"{make.__name__.replace('_', ' ')}, {count} segments"
                saved, saved_tour, theirs, ours = compare(folder, name, make(count, count))
                gains.setdefault(make in (random_lines, lettering), []).append(saved)
                # A job ends where it began: its length has the way back, that of vpype has not.
                if make is dashes:
                    saved = saved_tour
                if saved < (0.0 if make in (random_lines, lettering, clusters) else -0.05):
                    failed.append(f"{name}: longer than vpype")
                if ours > theirs:
                    failed.append(f"{name}: more CPU time than vpype")
        median = statistics.median(gains[True])
        print(f"\nrandom lines and lettering: median {median:.1f} % shorter, least {min(gains[True]):.1f} %")
        print(f"the others: median {statistics.median(gains[False]):.1f} % shorter")
        if median < 20.0:
            failed.append("the median is not 20 % shorter than vpype")
        if "--lkh" in sys.argv:
            print("\n| drawing | paths | LKH, mm (closed tour) | haptimill, mm (closed tour) | longer |")
            print("| --- | ---: | ---: | ---: | ---: |")
            for name, lines in (("random", random_lines(300, 1)), ("random", random_lines(1000, 1000)),
                                ("lettering", lettering(1000, 1000)),
                                ("clusters", clusters(300, 1)), ("clusters", clusters(400, 2)),
                                ("clusters", clusters(800, 3)), ("clusters", clusters(1000, 4))):
                cut(folder, lines)
                best = lkh(lines)
                closed = closed_air(os.path.join(folder, "d.ngc"))
                print(f"| {name} | {len(lines)} | {best:.0f} | {closed:.0f} | "
                      f"{100 * (closed / best - 1):.2f} % |", flush=True)
                if closed > 1.03 * best:
                    failed.append(f"{name}, {len(lines)} paths: more than 3 % longer than LKH")
            # A closed path ends where it starts: LKH orders the starts that haptimill chose.
            for lines in (squares(1000, 1000), squares(4000, 4000)):
                cut(folder, lines)
                program = os.path.join(folder, "d.ngc")
                best, closed = lkh_of_points(starts(program)), closed_air(program)
                print(f"| squares | {len(lines)} | {best:.0f} | {closed:.0f} | "
                      f"{100 * (closed / best - 1):.2f} % |", flush=True)
                if closed > 1.03 * best:
                    failed.append(f"squares, {len(lines)} paths: more than 3 % longer than LKH")
    if failed:
        sys.exit("\n".join(failed))


def starts(path):
    """The ends of the lifted moves: the origin and the start of each path."""
    at, found = [0.0, 0.0], [(0.0, 0.0)]
    for line in open(path):
        head = re.match(r"(G[0-3])\b", line)
        if head:
            words = dict(re.findall(r"([XY])(-?[\d.]+)", line))
            to = [float(words.get("X", at[0])), float(words.get("Y", at[1]))]
            if head[1] == "G0" and to != at and tuple(to) not in found:
                found.append(tuple(to))
            at = to
    return found


def lkh_of_points(points):
    """Length of the tour of LKH through points."""
    import elkai

    matrix = [[round(1000 * math.dist(a, b)) for b in points] for a in points]
    tour = elkai.DistanceMatrix(matrix).solve_tsp(runs=1)
    return length((points[a], points[b]) for a, b in zip(tour, tour[1:]))


def closed_air(path):
    at, total = [0.0, 0.0], 0.0
    for line in open(path):
        head = re.match(r"(G[0-3])\b", line)
        if head:
            found = dict(re.findall(r"([XY])(-?[\d.]+)", line))
            to = [float(found.get("X", at[0])), float(found.get("Y", at[1]))]
            total += math.dist(at, to) if head[1] == "G0" else 0.0
            at = to
    return total


main()
