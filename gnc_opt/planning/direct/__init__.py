"""One solve on one mesh, and why it failed."""
