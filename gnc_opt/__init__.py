"""gnc_opt."""
