"""Arcs of controls and state constraints: detection, meshes with free breakpoints, updates."""
