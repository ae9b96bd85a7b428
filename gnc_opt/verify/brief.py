"""What is too brief to matter."""

BRIEF = 1e-2
"""What lasts less than this share of a phase counts by its mean over it: loss of cost is size times duration."""
