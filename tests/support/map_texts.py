"""A map file of a newer version."""

NEWER = """\
format: localiser-map/1
name: hall
made: {by: someone, on: 2031-02-03}
frame: {axes: 'x right, y up, z backward', units: m, origin: north door}
landmarks:
- {id: 3, x: 1.25, z: -0.1, bottom_m: 0.0, top_m: 2.05, colour: [1, 2, 3]}
- {id: jamb, x: 1.0e-3, z: 7, cov: {xx: 1e-4, xz: 0.0, zz: 4e-4}, polarity: -1, source: floor plan}
"""
