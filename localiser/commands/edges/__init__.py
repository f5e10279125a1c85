"""`localiser edges`: find vertical edges in images, with tables and pictures of what each detector finds."""
