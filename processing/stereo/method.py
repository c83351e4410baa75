"""The names of the estimators, and of the channels that are solved."""

from __future__ import annotations

from importlib.metadata import entry_points
from typing import TYPE_CHECKING, Final, Literal, Protocol, cast, get_args

from acquisition import DataError

if TYPE_CHECKING:  # the commands list the names before numpy is needed
    from rig.arrays import Float32, Float64

Method = Literal["ls", "trimmed", "cauchy", "best"]
StereoChannel = Literal["auto", "gray", "rgb", "joint", "mosaic"]
METHODS: tuple[Method, ...] = get_args(Method)
_ENTRY_POINTS: Final = "sgp.estimators"


class Estimator(Protocol):
    """Function that estimates the scaled normal of each pixel of a block independently.

    An estimator does not depend on images, on masks, or on whether the lights are near. One of your
    own is given as a function, or by the name of an entry point of the group ``sgp.estimators``.
    """

    def __call__(
        self,
        values: Float32,
        vectors: Float32,
        law: Float32 | None = None,
        view: Float32 | None = None,
        /,
    ) -> tuple[Float64, Float64]:
        """Return the scaled normals and the residuals of P pixels under N lights.

        Parameters
        ----------
        values
            ``(P, N)`` float32 linear radiance, divided by the lights' intensities; not finite
            if a sample was not measured.
        vectors
            ``(1, 3, N)`` float32 light vectors (x, y, z) that all pixels share, or ``(P, 3, N)``.
        law
            ``(1, 2, N)`` or ``(P, 2, N)`` float32: variance of a sample without light, and its
            increase per value; None if the noise is not known.
        view
            ``(1, 3)`` or ``(P, 3)`` float32 unit vectors toward the camera, for models of
            reflectance; None for the direction z.

        Returns
        -------
        scaled
            ``(P, 3)`` float64, normal times albedo; 0 if the samples do not determine it.
        rms
            ``(P,)`` float64, root mean square of ``value - vector . scaled`` over the finite
            samples; 0 if there is no solution.
        """
        ...


# Estimators of users, by their names in records.
_GIVEN: dict[str, Estimator] = {}


def installed_methods() -> tuple[str, ...]:
    """Return the names of all methods: ours, then those of the group ``sgp.estimators``.

    Examples
    --------
    >>> from processing.stereo import installed_methods
    >>> installed_methods()[:2]
    ('ls', 'trimmed')
    """
    return (*METHODS, *sorted(entry_points(group=_ENTRY_POINTS).names))


def method_name(method: str | Estimator) -> Method:
    """Return the name of a method, under which records state it.

    Parameters
    ----------
    method
        A name in `METHODS`, that of an entry point of the group ``sgp.estimators``, or an
        estimator, which is then known by its module and name.

    Raises
    ------
    DataError
        If no method has this name. The message lists the known ones.
    """
    if not isinstance(method, str):
        if not callable(method):
            raise DataError(f"a method is a name or a function, not {type(method).__name__}")
        own = getattr(method, "__qualname__", type(method).__qualname__)
        name = f"{method.__module__}:{own}"
        _GIVEN[name] = method
        return cast(Method, name)
    if method not in METHODS and method not in _GIVEN:
        known = installed_methods()
        if method not in known:
            raise DataError(
                f"{method!r} is not a method of photometric stereo: use {', '.join(known)}"
            )
        try:
            _GIVEN[method] = entry_points(group=_ENTRY_POINTS)[method].load()
        except Exception as error:
            raise DataError(f"the method {method} cannot be loaded: {error!r}") from error
    return cast(Method, method)


def given_estimator(name: str) -> Estimator:
    """Return an estimator of a user by its name in records."""
    return _GIVEN[method_name(name)]
