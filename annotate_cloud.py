"""Public Python interface: parts and joints of people in depth images, label sets, schemes, training data.

The names in ``__all__`` are stable. Modules load on first use, so that the import is fast. Errors of users,
data and devices are ``CloudError``, one line each.
"""

from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from annotate.label_recording import Run
    from annotate.labelset.label_set import LabelSet
    from annotate.scheme.scheme import Scheme
    from annotate.scheme.scheme_file import load_scheme
    from annotate.suit.palette import Suit
    from eval.prediction.predictor import Person, Prediction, Predictor
    from eval.training.torch_dataset import TorchDataset as Dataset
    from sensors.errors import CloudError
    from sensors.importers.options import ImportOptions
    from sensors.rig.camera import Intrinsics as Camera
    from sensors.rig.frame import FrameSource

    __version__: str

__all__ = [
    "Camera",
    "CloudError",
    "Dataset",
    "FrameSource",
    "ImportOptions",
    "LabelSet",
    "Person",
    "Prediction",
    "Predictor",
    "Run",
    "Scheme",
    "Suit",
    "__version__",
    "label",
    "load_scheme",
    "open_source",
    "predict",
    "predict_source",
]

_PLACES = {
    "Camera": "sensors.rig.camera:Intrinsics",
    "CloudError": "sensors.errors:CloudError",
    "Dataset": "eval.training.torch_dataset:TorchDataset",
    "FrameSource": "sensors.rig.frame:FrameSource",
    "ImportOptions": "sensors.importers.options:ImportOptions",
    "LabelSet": "annotate.labelset.label_set:LabelSet",
    "Person": "eval.prediction.predictor:Person",
    "Prediction": "eval.prediction.predictor:Prediction",
    "Predictor": "eval.prediction.predictor:Predictor",
    "Run": "annotate.label_recording:Run",
    "Scheme": "annotate.scheme.scheme:Scheme",
    "Suit": "annotate.suit.palette:Suit",
    "load_scheme": "annotate.scheme.scheme_file:load_scheme",
}
"""Module and name of each re-exported object."""
_EXTRAS = {"Dataset": ("train", "torch")}
"""Extra that an object needs, and the extra's module."""


def predict(
    depth_mm: "NDArray[Any]",
    camera: "Camera",
    *,
    scheme: "Scheme | str | Path | None" = None,
    everybody: bool = False,
) -> "Prediction":
    """Label one depth image with the shipped network; arguments and errors as in ``Predictor``.

    The networks stay loaded for further images.
    """
    from eval.prediction.predictor import as_scheme, kept_predictor

    return kept_predictor(camera, as_scheme(scheme), everybody).predict(depth_mm)


def predict_source(
    source: "FrameSource | str | Path",
    out: str | Path,
    *,
    scheme: "Scheme | str | Path | None" = None,
    everybody: bool = False,
    weights: str | Path | None = None,
) -> "Run":
    """Label every frame of a recording with a network, as the command ``predict`` does.

    source: a recording, or its path. out: label set to write; an interrupted run continues there. Other
    arguments as in ``Predictor``. Raises ExistsError where ``out`` is of another recording or other settings.
    """
    from eval.network import predict_source as labelling
    from eval.prediction.predictor import as_scheme, labeller_of

    made = labeller_of(as_scheme(scheme), everybody, weights)
    return labelling.predict_source(_opened(source), made.network, Path(out), _silent, made.options)


def label(source: "FrameSource | str | Path", suit: "Suit | str | Path | None", out: str | Path) -> "Run":
    """Label every frame of a recording by the colours of a suit, as the command ``label`` does.

    suit: palette, or its file; None = extract the person alone. Other arguments and errors as in
    ``predict_source``.
    """
    from annotate.label_recording import SuitLabeller, label_source
    from annotate.suit.palette import load_suit

    palette = load_suit(Path(suit)) if isinstance(suit, (str, Path)) else suit
    return label_source(_opened(source), SuitLabeller(palette), Path(out), _silent)


def open_source(path: str | Path, options: "ImportOptions | None" = None) -> "FrameSource":
    """Open a session, or anything else that the command ``import`` reads.

    options: facts that the recording does not state. Raises FormatError for unknown kinds of files.
    """
    from sensors.importers.open_source import open_source as opened
    from sensors.importers.options import AS_STATED

    return opened(Path(path), options or AS_STATED)


def __getattr__(name: str) -> object:
    """Import a re-exported object. Raises CloudError where its extra is not installed."""
    if name == "__version__":
        from importlib.metadata import version

        return version("annotate-cloud")
    if name not in _PLACES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    if name in _EXTRAS:
        from cli.extras import check_extra

        check_extra(*_EXTRAS[name])
    module, _, attribute = _PLACES[name].partition(":")
    return getattr(import_module(module), attribute)


def __dir__() -> list[str]:
    """Return the names; objects whose extra is not installed are left out, because help() imports all."""
    from importlib.util import find_spec

    absent = {name for name, (_, module) in _EXTRAS.items() if find_spec(module) is None}
    return sorted({*globals(), *__all__} - absent)


def _opened(source: "FrameSource | str | Path") -> "FrameSource":
    return open_source(source) if isinstance(source, (str, Path)) else source


def _silent(frames: int) -> None:
    """Report no progress."""
