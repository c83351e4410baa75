"""``sgp verify``: compare results with their records."""

from __future__ import annotations

import rig
from sgp.cli.options import Input
from sgp.results import Result, VerifyMetrics, figures_of, verify_results


def verify(result: Input, *others: Input) -> Result:
    """Check that results are complete and unchanged, and that their inputs are those of then.

    Every file of a result is compared with the size and the hash in its record, and every input
    that is still there with its hash. Inputs that are gone are stated, but are no fault. Results of
    earlier programs have no hashes of their files: it is checked that their images can be read. The
    exit code is 4 if a file is missing, damaged or changed. Nothing is written.

    For example:

        sgp verify result
        sgp verify archive/*

    Parameters
    ----------
    result
        Folder that sgp has written, a folder of such folders, or a file that states what it was
        computed from, such as lights.json.
    others
        More of them.
    """
    found = verify_results([result, *others])
    counts = ", ".join(
        (
            rig.pluralize(found.records, "record"),
            rig.pluralize(found.files, "file of results", "files of results"),
            f"{rig.pluralize(found.inputs, 'input')} compared",
        )
    )
    verdict = rig.pluralize(found.faults, "fault") if found.faults else "no fault"
    return Result(
        metrics=figures_of(VerifyMetrics, found),
        warnings=found.notices,
        summary=[f"{counts}: {verdict} found"],
        ok=not found.faults,
    )
