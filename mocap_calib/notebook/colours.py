"""Individuals in colours, in all pictures alike."""

# by Okabe and Ito (jfly.uni-koeln.de/color), told apart by colour-blind people too; without black
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#f0e442")
UNASSIGNED = "#9a9a9a"  # of detections without an individual


def colour_of(individual: int) -> str:
    """Return the colour of an individual as #rrggbb, -1 = unassigned; seven colours in turn."""
    return UNASSIGNED if individual < 0 else COLOURS[individual % len(COLOURS)]


def rgb(colour: str) -> tuple[int, int, int]:
    """Return red, green and blue from 0 to 255 of #rrggbb."""
    red, green, blue = bytes.fromhex(colour.removeprefix("#"))
    return red, green, blue
