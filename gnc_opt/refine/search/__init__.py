"""Global search: many starts, distinct minima."""
