"""Groups of options on the help pages of commands with many of them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from cyclopts.help import HelpEntry

# A page with more parameters has groups.
_MANY = 25
_REST = "Output"
# In each group, the options that are used most come first.
_GROUPS = {
    "Lights": (
        "--lights --spheres --radius-mm --light-distance-mm --semi-calibrated --ambient --distant "
        "--interreflection --rig"
    ),
    "Images": (
        "--mask --camera --pixel-mm --exclude --align --crop --downscale --gamma --flat --sensor "
        "--max-pixels"
    ),
    "Method": "--method --channel --height-mm --rests-on-plane --filter --order --w",
    "Surface": "--smooth --discontinuity --k --height-sigma",
    "Mesh": "--stl --glb --obj --close --base --triangles --normal-texture",
    _REST: "--out --memory --green-out --strict --force",
}


def grouped(title: str, entries: Iterable[HelpEntry]) -> Iterator[tuple[str, list[HelpEntry]]]:
    """Yield the titles and entries of the groups; few entries are one group.

    Parameters
    ----------
    title
        Title of the arguments, and of one group.
    entries
        All parameters, in the order in which they are shown in one group.
    """
    left = list(entries)
    if len(left) <= _MANY:
        yield title, left
        return
    yield title, [entry for entry in left if entry.positional_label]
    options = {
        name: entry for entry in left if not entry.positional_label for name in entry.positive_names
    }
    for group, names in _GROUPS.items():
        found = [options.pop(name) for name in names.split() if name in options]
        if group == _REST:
            listed = {id(entry) for entry in found}
            found += [entry for entry in options.values() if id(entry) not in listed]
        if found:
            yield group, found
