# A part for the test of haptimill_post.py: objects with the attributes that FreeCAD gives to a
# post-processor. Prints the program.
import importlib.util
import math
import pathlib
import sys


class Command:
    def __init__(self, name, **parameters):
        self.Name = name
        self.Parameters = parameters


class Path:
    def __init__(self, commands):
        self.Commands = commands


class Operation:
    def __init__(self, label, commands, coolant=None, active=True):
        self.Label = label
        self.Path = Path(commands)
        self.Active = active
        if coolant:
            self.CoolantMode = coolant


def profile():
    """Contour 60 x 40 with round corners, in two depths; a cutter of 6 mm goes around outside."""
    feed = 400.0 / 60.0
    commands = [Command("G0", Z=5.0), Command("G0", X=0.0, Y=-8.0)]
    for depth in (-1.5, -3.0):
        commands += [
            Command("G0", X=0.0, Y=-8.0),
            Command("G0", Z=1.0),
            Command("G1", Z=depth, F=120.0 / 60.0),
            Command("G1", X=0.0, Y=-3.0, F=feed),
            Command("G1", X=-25.0, Y=-3.0, F=feed),
            Command("G2", X=-33.0, Y=5.0, Z=depth, I=0.0, J=8.0, K=0.0, F=feed),
            Command("G1", X=-33.0, Y=35.0, F=feed),
            Command("G2", X=-25.0, Y=43.0, Z=depth, I=8.0, J=0.0, K=0.0, F=feed),
            Command("G1", X=25.0, Y=43.0, F=feed),
            Command("G2", X=33.0, Y=35.0, Z=depth, I=0.0, J=-8.0, K=0.0, F=feed),
            Command("G1", X=33.0, Y=5.0, F=feed),
            Command("G2", X=25.0, Y=-3.0, Z=depth, I=-8.0, J=0.0, K=0.0, F=feed),
            Command("G1", X=0.0, Y=-3.0, F=feed),
            Command("G1", X=0.0, Y=-8.0, F=feed),
            Command("G0", Z=5.0),
        ]
    return commands


def pocket():
    """Round pocket of 16 mm: a helix down, then a full circle as two halves."""
    feed = 300.0 / 60.0
    commands = [Command("G0", Z=5.0), Command("G0", X=5.0, Y=20.0), Command("G0", Z=0.5)]
    z = 0.0
    commands.append(Command("G1", Z=0.0, F=100.0 / 60.0))
    for half in range(4):
        z -= 0.5
        x = -5.0 if half % 2 == 0 else 5.0
        commands.append(Command("G3", X=x, Y=20.0, Z=z, I=-5.0 if x < 0 else 5.0, J=0.0, F=feed))
    commands.append(Command("G3", X=-5.0, Y=20.0, Z=z, I=-5.0, J=0.0, F=feed))
    commands.append(Command("G3", X=5.0, Y=20.0, Z=z, I=5.0, J=0.0, F=feed))
    commands.append(Command("G1", X=0.0, Y=20.0, F=feed))
    commands.append(Command("G0", Z=5.0))
    return commands


def holes():
    commands = [Command("G0", Z=10.0), Command("G90"), Command("G98")]
    for index in range(4):
        angle = math.radians(45 + 90 * index)
        x, y = 20.0 * math.cos(angle), 20.0 + 14.0 * math.sin(angle)
        commands.append(Command("G83", X=x, Y=y, Z=-6.0, R=2.0, Q=2.0, F=80.0 / 60.0))
    return commands + [Command("G80"), Command("G0", Z=10.0)]


PART = [
    Operation("Fixture", [Command("G54")]),
    Operation("TC: 6mm end mill", [Command("M6", T=1), Command("M3", S=6000.0)]),
    Operation("Profile", [Command("(Profile)")] + profile(), coolant="Flood"),
    Operation("Skipped", [Command("G1", X=9999.0)], active=False),
    Operation("Pocket", pocket(), coolant="Flood"),
    Operation("TC: 3mm drill", [Command("M6", T=2), Command("M3", S=3000.0)]),
    Operation("Drilling", holes(), coolant="Mist"),
]

if __name__ == "__main__":
    post = pathlib.Path(__file__).parent.parent / "haptimill_post.py"
    spec = importlib.util.spec_from_file_location("haptimill_post", post)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    sys.stdout.write(module.export(PART, "-", " ".join(sys.argv[1:])))
