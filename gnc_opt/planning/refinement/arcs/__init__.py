"""Control structures: which control sits on which bound when, with the switch times as variables."""
