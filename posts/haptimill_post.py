# Post-processor for FreeCAD (workbench CAM, formerly Path), versions 0.19 and newer.
#
# Copy this file into the macro folder of FreeCAD and choose `haptimill` in the output settings of
# the job. Arguments of the job:
#   --no-comments     no comments
#   --no-length       no G43: the tool lengths are not in a tool table
#   --precision N     decimals of coordinates, 1 to 6 (default 4)
#   --output-inches   inch in place of mm
#
# FreeCAD calls export() with the operations of the job. Lengths are in mm, feeds in mm/s.

TOOLTIP = "Post-processor for Haptimill"
TOOLTIP_ARGS = "--no-comments --no-length --precision N --output-inches"

# Words in the order in which they are written.
LETTERS = "XYZABCIJKRQPLFSTHD"
LENGTHS = "XYZIJKRQ"
CYCLES = ("G73", "G81", "G82", "G83", "G85", "G89")
RAPID = ("G0", "G00")


class Settings:
    """Arguments of the job."""

    def __init__(self, arguments):
        self.comments = True
        self.length = True
        self.precision = 4
        self.inch = False
        words = arguments.split()
        while words:
            word = words.pop(0)
            if word == "--no-comments":
                self.comments = False
            elif word == "--no-length":
                self.length = False
            elif word == "--output-inches":
                self.inch = True
            elif word == "--precision" and words and words[0].isdigit():
                self.precision = min(max(int(words.pop(0)), 1), 6)
            else:
                raise ValueError("unknown argument %s; %s" % (word, TOOLTIP_ARGS))


def number(value, decimals):
    text = "%.*f" % (decimals, value)
    return "0" + "." + "0" * decimals if float(text) == 0.0 else text


def comment(text):
    """A comment without nested parentheses and line ends."""
    plain = "".join(" " if letter in "()\r\n" else letter for letter in text)
    return "(" + plain.strip() + ")"


def commands_of(operation):
    """The commands of an operation, with its placement where FreeCAD can apply it."""
    try:
        from PathScripts.PathUtils import getPathWithPlacement
    except ImportError:
        return operation.Path.Commands
    return getPathWithPlacement(operation).Commands


class Writer:
    def __init__(self, settings):
        self.settings = settings
        self.lines = []
        self.modal = {}
        self.motion = None

    def line(self, text):
        self.lines.append(text)

    def note(self, text):
        if self.settings.comments:
            self.line(comment(text))

    def word(self, letter, value):
        scale = 1.0 / 25.4 if self.settings.inch and letter in LENGTHS + "F" else 1.0
        if letter == "F":
            # FreeCAD gives mm/s.
            return "F" + number(value * 60.0 * scale, 3)
        if letter in "THDL":
            return letter + str(int(value))
        if letter == "S":
            return "S" + str(int(round(value)))
        return letter + number(value * scale, self.settings.precision)

    def command(self, command):
        name, parameters = command.Name, dict(command.Parameters)
        if name.startswith("("):
            self.note(name.strip("()"))
            return
        if name in ("M6", "M06"):
            self.change_tool(parameters)
            return
        words = [name]
        is_cycle = name in CYCLES
        for letter in LETTERS:
            if letter not in parameters:
                continue
            if letter == "F" and (name in RAPID or parameters["F"] <= 0.0):
                continue
            word = self.word(letter, parameters[letter])
            # Words of a cycle and centres of arcs are written always.
            repeats = letter in "XYZABCF" and not is_cycle and name not in ("G2", "G3", "G02", "G03")
            if repeats and self.modal.get(letter) == word:
                continue
            words.append(word)
            if letter in "XYZABCF":
                self.modal[letter] = word
        if is_cycle:
            # The level after a cycle is not always its end.
            self.modal.pop("Z", None)
        if name in RAPID + ("G1", "G01") and len(words) == 1:
            return
        self.line(" ".join(words))

    def change_tool(self, parameters):
        tool = int(parameters.get("T", 0))
        self.modal.clear()
        self.line("M5")
        self.line("T%d M6" % tool)
        if self.settings.length:
            self.line("G43 H%d" % tool)


def export(objectslist, filename, argstring):
    """Called by FreeCAD. Returns the program, and writes it unless the name is `-`."""
    writer = Writer(Settings(argstring))
    writer.note("Written by the FreeCAD post-processor of Haptimill")
    writer.line("G17 G40 G49 G80 G90 G94")
    writer.line("G20" if writer.settings.inch else "G21")
    coolant = "None"
    for operation in objectslist:
        if not hasattr(operation, "Path"):
            raise ValueError("%s has no path" % getattr(operation, "Label", "an object"))
        if not getattr(operation, "Active", True):
            continue
        writer.note(operation.Label)
        mode = getattr(operation, "CoolantMode", "None")
        if mode != coolant:
            writer.line({"Flood": "M8", "Mist": "M7"}.get(mode, "M9"))
            coolant = mode
        for command in commands_of(operation):
            writer.command(command)
    if coolant != "None":
        writer.line("M9")
    for text in ("M5", "G17 G40 G49 G80 G90", "M30"):
        writer.line(text)
    program = "\n".join(writer.lines) + "\n"
    if filename != "-":
        with open(filename, "w") as output:
            output.write(program)
    return program
