"""Newton's method on the switching times of bang-bang controls."""
