"""Direct collocation on one mesh: solves, repeated attempts and failure reports."""
