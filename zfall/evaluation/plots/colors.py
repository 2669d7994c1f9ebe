"""Colours and lines of all plots: those of Okabe and Ito, which the colour-blind tell apart."""

BLACK, BLUE, VERMILION, GREEN = "#000000", "#0072B2", "#D55E00", "#009E73"
ORANGE, SKY, PURPLE, GREY = "#E69F00", "#56B4E9", "#CC79A7", "#777777"
# Sixteen lines that differ, also without colour: no two have the same dashes and marks.
LINES = [("-", BLUE), ("--", VERMILION), ("-.", GREEN), (":", BLACK),
         ("o-", ORANGE), ("s--", SKY), ("^:", PURPLE), ("D-.", GREY),
         ("x-", BLUE), ("v--", VERMILION), ("P-.", GREEN), ("o:", BLACK),
         ("s-", ORANGE), ("D--", SKY), ("x:", PURPLE), ("^-.", GREY)]  # fmt: skip
