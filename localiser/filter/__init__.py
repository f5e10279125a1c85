"""The particle filter: Monte Carlo localisation and what it believes."""
