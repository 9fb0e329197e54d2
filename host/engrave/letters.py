#!/usr/bin/env python3
"""Writes `host/engrave/data/letters.toml`: the texts of the thesis as closed lines.

Needs the Python package fonttools and the DejaVu fonts:
    python3 host/engrave/letters.py /usr/share/fonts/truetype/dejavu

The fonts of the thesis are not free. DejaVu Sans has the shapes and widths of Verdana, DejaVu Serif
stands in for Times New Roman and Angsana New. A curve becomes four lines, as an exploded text does.
"""

import os
import sys
import textwrap

from fontTools.pens.basePen import BasePen
from fontTools.ttLib import TTFont

CHORDS = 4
TEXTS = (
    ("kmitl", "DejaVu Sans"), ("VWXYZ", "DejaVu Serif"), ("ABCD", "DejaVu Serif"),
    ("efghij", "DejaVu Serif"), ("klmn", "DejaVu Sans"), ("opqrstu", "DejaVu Sans"),
)
HEAD = """\
# The texts of the thesis as closed lines: x and y of their corners, in units of the font.
# Written by `host/engrave/letters.py` from the DejaVu fonts, of which this is the notice:
"""


class Lines(BasePen):
    """Collects the contours of a glyph; curves as chords."""

    def __init__(self, glyphs):
        super().__init__(glyphs)
        self.contours = []

    def _moveTo(self, at):
        self.contours.append([at])

    def _lineTo(self, at):
        self.contours[-1].append(at)

    def _qCurveToOne(self, over, to):
        at = self.contours[-1][-1]
        for k in range(1, CHORDS + 1):
            t = k / CHORDS
            weights = ((1 - t) ** 2, 2 * t * (1 - t), t * t)
            self.contours[-1].append(tuple(
                sum(w * p[axis] for w, p in zip(weights, (at, over, to))) for axis in range(2)))


def contours(font, text):
    """Contours of a text from its first baseline point, without repeated corners."""
    glyphs, names, x, out = font.getGlyphSet(), font.getBestCmap(), 0, []
    for letter in text:
        pen = Lines(glyphs)
        glyphs[names[ord(letter)]].draw(pen)
        for contour in pen.contours:
            corners = [(round(x + at[0]), round(at[1])) for at in contour]
            corners = [at for k, at in enumerate(corners) if at != corners[k - 1]]
            out.append([value for at in corners for value in at])
        x += glyphs[names[ord(letter)]].width
    return out


def main():
    folder = sys.argv[1]
    def font(name):
        return TTFont(os.path.join(folder, name.replace(" ", "") + ".ttf"))

    fonts = {name: font(name) for _, name in TEXTS}
    notice = fonts["DejaVu Sans"]["name"].getDebugName(13)
    target = os.path.join(os.path.dirname(os.path.abspath(__file__)), "data", "letters.toml")
    with open(target, "w") as out:
        out.write(HEAD)
        for line in notice.splitlines():
            for part in textwrap.wrap(line, 96) or [""]:
                out.write(f"# {part}".rstrip() + "\n")
        for text, name in TEXTS:
            out.write(f'\n[[text]]\ntext = "{text}"\nfont = "{name}"\n')
            out.write(f"capital = {fonts[name]['glyf']['H'].yMax}\ncontours = [\n")
            for one in contours(fonts[name], text):
                indents = {"initial_indent": "    ", "subsequent_indent": "        "}
                out.write(textwrap.fill(f"{one},", 96, **indents) + "\n")
            out.write("]\n")


main()
