"""Low thrust: orbit transfers with long burns."""
