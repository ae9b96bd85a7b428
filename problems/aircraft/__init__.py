"""Aircraft: climb, turns, soaring, abort landing."""
