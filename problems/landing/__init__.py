"""Landing: powered descent."""
