"""The engraver with room for large drawings, for the scripts of this folder."""


def write(path):
    """Writes `machines/engraver.toml` with an area of 1200 x 1200 mm."""
    text = open("machines/engraver.toml").read()
    for low, high in (("low_mm = 0.0", "low_mm = -100.0"), ("low_mm = -4.0", "low_mm = -104.0"),
                      ("high_mm = 110.0", "high_mm = 1200.0"), ("high_mm = 250.0", "high_mm = 1200.0"),
                      ("high_mm = 112.0", "high_mm = 1204.0"), ("high_mm = 252.0", "high_mm = 1204.0")):
        text = text.replace(low, high)
    open(path, "w").write(text)
