"""Verbs that make labels and correct them: label, predict, suit learn, fix."""

import math
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from typer import Argument, Option

from cli.console import Json, Names, Overwrite, check_room, clear, finish, finish_run, progress, say
from cli.extras import check_extra, needing
from cli.scheme import PAPER
from cli.sessions import EachOptions, Scheduler, label_each, open_recording, sessions_in
from sensors.files.atomic import check_free, check_there, write_bytes
from sensors.importers.open_source import doubts_of, open_source, opener_at

if TYPE_CHECKING:
    from annotate.label_recording import Run, SuitLabeller
    from annotate.labelset.labelled_frames import LabelledFrames
    from annotate.scheme.scheme import Scheme
    from annotate.suit.palette import Suit
    from eval.network.colour_labeller import ColourLabeller
    from sensors.importers.open_source import Source

COLOUR = "colour"  # in place of a network's file: MediaPipe Pose
suit_app = typer.Typer(help="Palettes of the colour-coded suit.", no_args_is_help=True)


def _window(window_c: tuple[float, float] | None) -> tuple[float, float] | None:
    if window_c is None:
        return None
    low, high = window_c
    if not -math.inf < low < high < math.inf:
        raise typer.BadParameter(f"{low} to {high} is not a range; give the lower temperature first")
    return window_c


Window = Annotated[
    tuple[float, float] | None,
    Option(
        help="Lowest and highest temperature of a person, degrees Celsius. Default: found in each frame.",
        callback=_window,
    ),
]
Labels = Annotated[Path, Option(help="Label set to write; an interrupted run continues there.")]


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
        from eval.network.colour_labeller import label_by_colour
        from eval.network.suit_and_colour import SuitAndColourLabeller

        by_colour = self._by_colour(by_suit.scheme if by_suit.suit else None)
        if by_suit.suit is None:
            return lambda source, out, advance: label_by_colour(source, by_colour, out, advance)
        both = SuitAndColourLabeller(by_suit, by_colour)
        steps = {"label": suit_step(by_suit), "label_by_colour": by_colour.step}
        return lambda source, out, advance: run(source, steps, out, both, advance)

    def _by_colour(self, of_suit: "Scheme | None") -> "ColourLabeller":
        from annotate.scheme.scheme_file import load_scheme
        from annotate.witness.blazepose import BlazePose
        from annotate.witness.onnx_pose import OnnxPose
        from annotate.witness.pose_network import PoseNetwork
        from eval.network.colour_labeller import ColourLabeller
        from eval.network.onnx_network import OnnxNetwork

        network = OnnxNetwork()
        scheme = load_scheme(self.scheme) if self.scheme else network.usual_scheme
        if of_suit and of_suit != scheme:
            if self.scheme:
                raise typer.BadParameter(f"the suit has scheme {of_suit.name!r}; leave out --scheme")
            scheme = of_suit
        witness: PoseNetwork = BlazePose() if self.by == COLOUR else OnnxPose(Path(self.by or ""))
        return ColourLabeller(witness, network, scheme, self.everybody, self.window_c)


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
    work = choices.work()
    if source is None:
        one = partial(_label, choices, names)
        label_each("label", one, sessions, out, EachOptions(scheduler, overwrite, json))
        return
    clear(out, store.MANIFEST, overwrite, session, *given)
    suit_notes = _notes_on(choices.by_suit.suit, choices.by_suit.scheme) if choices.by_suit.suit else ()
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


def _notes_on(suit: "Suit", scheme: "Scheme") -> list[str]:
    """Return the warnings about a suit whose labels have a scheme."""
    if suit.scheme == scheme:
        return [*suit.notes]
    why = (
        f"labels have the parts of scheme {scheme.name!r}, because parts of the suit's scheme "
        f"{suit.scheme.name!r} are coarser or lack a colour of their own"
    )
    return [*suit.notes, why]


def _label(choices: LabelChoices, names: bool, session: Path, out: Path) -> "Run":
    return choices.work()(open_recording(session, names), out, lambda _: None)


@suit_app.command()
def learn(
    out: Annotated[Path, Option(help="Palette (TOML) to write.")],
    labels: Annotated[Path | None, Argument(help="Label set with corrected frames.")] = None,
    session: Annotated[Path | None, Option(help="Recording from which the labels were made.")] = None,
    frame: Annotated[
        list[str] | None,
        Option(help="Id of a correctly labelled frame; repeatable. Default: all corrected frames."),
    ] = None,
    swatches: Annotated[
        Path | None,
        Option(
            help="Instead of labels: photograph of the suit's cloths on plain paper, "
            "row by row in the order of the scheme's parts."
        ),
    ] = None,
    scheme: Annotated[
        Path | None,
        Option(help="Scheme of the photographed cloths, name or file (TOML).", show_default="paper"),
    ] = None,
    overwrite: Overwrite = False,
    json: Json = False,
) -> None:
    """Learn the suit's palette, in the scheme of corrected frames, or from a photograph of its cloths."""
    from annotate.labelset.label_set import LabelSet
    from annotate.scheme.scheme_file import load_scheme
    from annotate.suit.palette import suit_to_toml
    from annotate.suit.palette_learning import (
        clouds_with,
        corrected_frames,
        suit_from_labels,
        suit_from_photo,
    )

    check_free(out, overwrite)
    if swatches is not None and labels is None and session is None and not frame:
        check_there(swatches)
        palette = suit_from_photo(swatches, out.stem, load_scheme(str(scheme or PAPER)))
    elif swatches is None and scheme is None and labels is not None and session is not None:
        chosen, source = LabelSet.open(labels), open_source(session)
        ids = frame or corrected_frames(chosen)
        palette = suit_from_labels(clouds_with(chosen, ids, source), out.stem, chosen.scheme)
    else:
        raise typer.BadParameter("give labels with --session, or --swatches with or without --scheme")
    write_bytes(out, suit_to_toml(palette).encode())
    say(*palette.notes)
    result = {"suit": str(out), "colors": len(palette.parts), "notes": list(palette.notes)}
    finish(result, json, f"{len(palette.parts)} colours in {out}")


@dataclass(frozen=True)
class PredictChoices:
    """Options of ``predict``. Raises BadParameter for options that exclude each other.

    again: refine labels by the depth of the room; None = only for recordings. learnt: further refinement
    network. scheme: name or file of the labels' scheme; None = the network's usual one.
    """

    weights: Path | None
    window_c: tuple[float, float] | None
    probabilities: bool
    everybody: bool
    again: bool | None
    learnt: Path | None
    scheme: Path | None = None

    def __post_init__(self) -> None:
        if self.probabilities and self.everybody:
            raise typer.BadParameter(
                "--probabilities stores one person, --everybody labels all; leave out one of them"
            )
        if (self.again or self.learnt) and (self.probabilities or self.everybody):
            raise typer.BadParameter(
                "--again and --learnt refine one person; leave out --probabilities and --everybody"
            )

    def work(self, opened: "LabelledFrames | Source", out: Path) -> "Callable[[Callable[[int], None]], Run]":
        """Return a function that labels the opened frames or recording; its argument reports progress."""
        from annotate.labelset.labelled_frames import LabelledFrames
        from annotate.scheme.scheme_file import load_scheme
        from annotate.segmentation.suit_network import SuitNetwork
        from eval.network.onnx_network import SHIPPED_WEIGHTS, OnnxNetwork
        from eval.network.predict import PredictOptions, fits, predict_frames
        from eval.network.predict_source import predict_source
        from eval.network.refine import shipped_refinement_network

        scheme = load_scheme(str(self.scheme)) if self.scheme else None
        network = OnnxNetwork(self.weights or SHIPPED_WEIGHTS, scheme=scheme if self.weights else None)
        refiners = [SuitNetwork(self.learnt)] if self.learnt else []
        if isinstance(opened, LabelledFrames):
            refiners = [shipped_refinement_network(), *refiners] if self.again else refiners
            options = PredictOptions(self.probabilities, refiners=refiners, scheme=scheme)
            options.chained(network)
            return partial(predict_frames, opened, network, out, options=options)
        once = self.again is False or self.probabilities or self.everybody
        room = None if once else shipped_refinement_network()
        options = PredictOptions(
            self.probabilities, self.everybody, self.window_c, room, refiners, scheme=scheme
        )
        if room and self.again is None and not fits(options, network):
            say(
                f"labels are not refined: the refinement network cannot give scheme "
                f"{(scheme or network.usual_scheme).name!r} from {network.own.name!r}"
            )
            options = replace(options, room_refiner=None)
        options.chained(network)
        return partial(predict_source, opened, network, out, options=options)


def predict(
    source: Annotated[
        Path, Argument(help="Session, label set, dataset, or what import reads; or a folder of sessions.")
    ],
    out: Labels,
    weights: Annotated[Path | None, Option(help="Network (.onnx).", show_default="the shipped one")] = None,
    window: Window = None,
    probabilities: Annotated[
        bool, Option("--probabilities", help="Also store the probabilities of all classes, 12 kB per frame.")
    ] = False,
    joints: Annotated[
        Path | None, Option(help="File for joints, facing and posture: .jsonl or .csv.")
    ] = None,
    everybody: Annotated[bool, Option("--everybody", help="Label all persons, not the subject.")] = False,
    again: Annotated[
        bool | None,
        Option(help="Refine the labels by the depth of the room.", show_default="recordings alone"),
    ] = None,
    learnt: Annotated[
        Path | None, Option(help="Refinement network (.onnx) of this person and room, from learn.")
    ] = None,
    scheme: Annotated[
        Path | None,
        Option(
            help="Scheme of the labels, name or file (TOML).",
            show_default="the network's; paper for a network of regions",
        ),
    ] = None,
    names: Names = False,
    scheduler: Scheduler = None,
    overwrite: Overwrite = False,
    json: Json = False,
) -> None:
    """Label depth images with a network; label sets and datasets keep their outlines of the person."""
    from annotate.labelset import label_set as store
    from eval.network.joint_files import check_kind, write_joints

    if joints is not None:
        check_kind(joints)
        check_free(joints, overwrite)
    choices = PredictChoices(weights, window, probabilities, everybody, again, learnt, scheme)
    given = [path for path in (weights, learnt) if path]
    check_there(*given)
    if sessions := sessions_in(source, scheduler):
        if joints is not None:
            raise typer.BadParameter("--joints is for one session; its notes in each label set hold them")
        one = partial(_predict, choices, names)
        label_each("predict", one, sessions, out, EachOptions(scheduler, overwrite, json))
        return
    opened = _opened(source, everybody, names)
    check_room(out, store.MANIFEST, overwrite, source, *given)
    work = choices.work(opened, out)
    clear(out, store.MANIFEST, overwrite, source, *given)
    started, total = time.monotonic(), len(opened)
    with progress("predict", total) as advance:
        run = work(advance)
    ms = 1000 * (time.monotonic() - started) / max(1, total)
    result = {"frames": len(run.labels), "ms_per_frame": round(ms, 2)}
    if joints is not None:
        result["people"] = write_joints(run.labels, joints)
    finish_run(result, run, json, f"{len(run.labels)} frames in {out}, {ms:.0f} ms each")


def _predict(choices: PredictChoices, names: bool, session: Path, out: Path) -> "Run":
    return choices.work(open_recording(session, names), out)(lambda _: None)


def _opened(source: Path, everybody: bool, names: bool) -> "LabelledFrames | Source":
    """Open labels or a recording; print what a recording lacks."""
    from annotate.labelset.labelled_frames import holds_frames, open_frames
    from eval.network.predict import check_one_person

    if holds_frames(source):
        if everybody:
            raise typer.BadParameter(
                "--everybody needs a recording; label sets keep their outline of one person"
            )
        labels = open_frames(source)
        check_one_person(labels)
        return labels
    frames = open_recording(source, names)
    say(*frames.notes, *doubts_of(frames))
    return frames


def fix(
    labels: Annotated[Path, Argument(help="Label set to correct.")],
    session: Annotated[
        Path | None,
        Option(help="Recording, for colour and temperature. Default: the last one given, or the one beside."),
    ] = None,
    compare: Annotated[Path | None, Option(help="Another label set, to show the differences.")] = None,
    who: Annotated[str, Option(help="Name of the person who corrects. Default: the system user.")] = "",
    read_only: Annotated[bool, Option("--read-only", help="Open without changing anything.")] = False,
) -> None:
    """Correct part labels in a window; F1 shows the keys. Every stroke is saved at once."""
    check_extra("gui", "PySide6", "pyvista", "pyvistaqt")
    from annotate.correction.correction import Correction
    from annotate.labelset.label_set import LabelSet

    for path in (labels, *([compare] if compare else ())):
        LabelSet.open(path)
    if session is not None:
        opener_at(session)
    with needing("gui"):
        from annotate.gui.app import recording_of, run_window
        from annotate.gui.learning import LearnCommand
    recording = recording_of(labels, session)
    model = labels.resolve().with_name(f"{labels.resolve().name}.learnt")
    command = learn_command(labels, recording, model)
    correction = Correction.open(labels, who, read_only=read_only)
    states = run_window(correction, recording, compare, LearnCommand(command, model / "labels"))
    print(f"{labels}: " + ", ".join(f"{count} {state}" for state, count in states.items()))


def learn_command(labels: Path, session: Path | None, model: Path) -> tuple[str, ...]:
    """Return the command that fine-tunes on corrections in the background, into the folder ``model``."""
    # -P: no module of the folder in which the user stands.
    verb = (sys.executable, "-P", "-m", "cli.main", "learn", str(labels), "--out", str(model), "--json")
    return (*verb, *(("--session", str(session)) if session else ()))
