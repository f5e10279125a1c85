"""`localiser doctor`: does everything fit together?"""
