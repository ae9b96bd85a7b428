"""Entry: flight from orbit into an atmosphere."""
