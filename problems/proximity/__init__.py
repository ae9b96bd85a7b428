"""Proximity operations: rendezvous, docking, station keeping."""
