"""A set of optimal control problems in JSON: `reader` builds them, `references` compares, `solve` tabulates."""
