"""Two boards get the same random items; whatever they do differently is reported.

The boards are programs behind ptys whose clocks stand still between orders, so nothing depends on
how busy the machine is. `tests.rig.differential.compare` is the entry; what may differ is listed in
`tests.rig.differential.difference`.
"""
