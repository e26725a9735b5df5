"""Verb ``label``: segment the body parts by a suit, by colour, or by both."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from typer import Argument, Option

from cli.console import Json, Names, Overwrite, check_room, clear, finish_run, progress, say
from cli.sessions import EachOptions, Scheduler, label_each, open_recording, sessions_in
from cli.verbs.labels.label_options import Labels, Window
from sensors.errors import CloudError
from sensors.files.atomic import check_there
from sensors.importers.open_source import doubts_of

if TYPE_CHECKING:
    from annotate.label_recording import Run, SuitLabeller
    from annotate.scheme.scheme import Scheme
    from eval.network.colour.colour_labeller import ColourLabeller
    from sensors.importers.open_source import Source

COLOUR = "colour"  # in place of a network's file: MediaPipe Pose


@dataclass(frozen=True)
class LabelChoices:
    """Options of ``label``. by: "colour", or the path of a pose network (.onnx); None = the suit alone.

    Raises BadParameter for options that exclude each other.
    """

    suit: Path | None = None
    window_c: tuple[float, float] | None = None
    weights: Path | None = None
    by: str | None = None
    scheme: str | None = None
    everybody: bool = False

    def __post_init__(self) -> None:
        if self.by is None and (self.scheme or self.everybody):
            raise typer.BadParameter("--scheme and --everybody need --by; add --by colour")
        if self.by and not self.suit and self.weights:
            raise typer.BadParameter("--weights is for --suit; add --suit or leave it out")
        if self.suit and self.everybody:
            raise typer.BadParameter("--suit labels one person; leave out --everybody")

    @cached_property
    def by_suit(self) -> "SuitLabeller":
        """Return the labeller by the suit, without parts if no suit is given."""
        from annotate.label_recording import SuitLabeller
        from annotate.segmentation.suit_network import SuitNetwork, shipped_suit_network
        from annotate.suit.palette import load_suit

        palette = load_suit(self.suit) if self.suit else None
        network = SuitNetwork(self.weights) if self.weights else shipped_suit_network()
        return SuitLabeller(palette, network.for_suit(palette), self.window_c)

    def work(self) -> "Callable[[Source, Path, Callable[[int], None]], Run]":
        """Load the networks; return a function that labels a recording into a folder with progress."""
        from annotate.label_recording import label_source, run, suit_step

        by_suit = self.by_suit
        if self.by is None:
            return lambda source, out, advance: label_source(source, by_suit, out, advance)
        from eval.network.colour.colour_labeller import label_by_colour
        from eval.network.colour.suit_and_colour import SuitAndColourLabeller

        by_colour = self._by_colour(by_suit.scheme if by_suit.suit else None)
        both = SuitAndColourLabeller(by_suit, by_colour)
        steps = {"label": suit_step(by_suit), "label_by_colour": by_colour.step}

        def labelled(source: "Source", out: Path, advance: Callable[[int], None]) -> "Run":
            check_colour(source)
            if by_suit.suit is None:
                return label_by_colour(source, by_colour, out, advance)
            return run(source, steps, out, both, advance)

        return labelled

    def _by_colour(self, of_suit: "Scheme | None") -> "ColourLabeller":
        from annotate.scheme.scheme_file import load_scheme
        from annotate.witness.blazepose import BlazePose
        from annotate.witness.onnx_pose import OnnxPose
        from annotate.witness.pose_network import PoseNetwork
        from eval.network.colour.colour_labeller import ColourLabeller
        from eval.network.onnx_network import OnnxNetwork

        network = OnnxNetwork()
        scheme = load_scheme(self.scheme) if self.scheme else network.usual_scheme
        if of_suit and of_suit != scheme:
            if self.scheme:
                raise typer.BadParameter(f"the suit has scheme {of_suit.name!r}; leave out --scheme")
            scheme = of_suit
        witness: PoseNetwork = BlazePose() if self.by == COLOUR else OnnxPose(Path(self.by or ""))
        return ColourLabeller(witness, network, scheme, self.everybody, self.window_c)


def check_colour(source: "Source") -> None:
    """Check that a recording can be labelled by colour.

    Raises CalibrationError where colour is neither aligned nor calibrated, CloudError without colour images.
    """
    from annotate.witness.coloured_cloud import ColourFuser

    ColourFuser(source.calibration)
    if "no colour images" in source.notes:
        raise CloudError(
            "the recording has no colour images; give one with colour, or label by depth: predict"
        )


def label(
    session: Annotated[
        Path, Argument(help="Session, or anything else that import reads; or a folder of sessions.")
    ],
    out: Labels,
    suit: Annotated[Path | None, Option(help="Palette of the colour-coded suit (TOML).")] = None,
    by: Annotated[
        str | None,
        Option(
            help="colour: label ordinary clothes by MediaPipe's pose network; or another pose network "
            "(.onnx).",
        ),
    ] = None,
    window: Window = None,
    weights: Annotated[
        Path | None, Option(help="Weights from train-labels.", show_default="the shipped ones")
    ] = None,
    scheme: Annotated[
        str | None,
        Option(help="With --by: scheme of the labels, name or file (TOML).", show_default="paper"),
    ] = None,
    everybody: Annotated[
        bool, Option("--everybody", help="With --by: label all persons, not the subject.")
    ] = False,
    names: Names = False,
    scheduler: Scheduler = None,
    overwrite: Overwrite = False,
    json: Json = False,
) -> None:
    """Find the person and segment the body parts by the suit, or by a colour pose network (--by)."""
    from annotate.labelset import label_set as store

    choices = LabelChoices(suit, window, weights, by, scheme, everybody)
    given = [path for path in (suit, weights, Path(by) if by and by != COLOUR else None) if path]
    sessions = sessions_in(session, scheduler)
    source = None if sessions else open_recording(session, names)
    check_there(*given)
    if source is not None:
        check_room(out, store.MANIFEST, overwrite, session, *given)
    work, suit_notes = choices.work(), choices.by_suit.notes
    if source is None:
        say(*suit_notes)
        one = partial(_label, choices, names)
        label_each("label", one, sessions, out, EachOptions(scheduler, overwrite, json))
        return
    clear(out, store.MANIFEST, overwrite, session, *given)
    notes = [*source.notes, *doubts_of(source), *suit_notes]
    say(*notes)
    started = time.monotonic()
    with progress("label", len(source)) as advance:
        run = work(source, out, advance)
    seconds = (time.monotonic() - started) / max(1, len(source))
    frames, review = len(run.labels), run.review_order()
    result = {"frames": frames, "seconds_per_frame": round(seconds, 4), "review": review, "notes": notes}
    text = f"{frames} frames in {out}, {seconds:.2f} s each; review first: {', '.join(review[:5])}"
    finish_run(result, run, json, text)


def _label(choices: LabelChoices, names: bool, session: Path, out: Path) -> "Run":
    return choices.work()(open_recording(session, names), out, lambda _: None)
