"""Feeds two boards the same random items and reports every difference.

The boards are programs behind ptys whose clocks stop between orders, so nothing depends on the load
of the computer. The entry point is `tests.rig.differential.compare`;
`tests.rig.differential.difference` lists the allowed differences.
"""
