"""Photometric stereo from a rig or from photographs, and analysis of surface detail in normal maps.

For example:

    sgp demo --out demo
    sgp run photographs/ --lights lights.json --out result
"""
