"""Controllers and estimators as plain C99."""
