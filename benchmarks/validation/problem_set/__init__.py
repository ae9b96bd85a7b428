"""A set of optimal control problems in JSON: `reader` builds them, `solve` solves and `references` compares."""
