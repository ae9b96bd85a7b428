"""Classics: textbook problems, most of them with closed forms."""
