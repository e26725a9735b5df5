"""Verb ``predict``: label depth images with a network."""

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from typer import Argument, Option

from cli.console import Json, Names, Overwrite, check_room, clear, finish_run, progress, say
from cli.sessions import EachOptions, Scheduler, label_each, open_recording, sessions_in
from cli.verbs.labels.label_options import Labels, Window
from sensors.files.atomic import check_free, check_suffix, check_there
from sensors.importers.open_source import doubts_of

if TYPE_CHECKING:
    from annotate.label_recording import Run
    from annotate.labelset.labelled_frames import LabelledFrames
    from eval.network.onnx_network import OnnxNetwork
    from eval.network.predict import PredictOptions
    from sensors.importers.open_source import Source


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
        from eval.network.predict import PredictOptions, predict_frames
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
        if room and self.again is None and (why := self._why_unrefined(options, network)):
            say(f"labels are not refined by the room: {why}")
            options = replace(options, room_refiner=None)
        options.chained(network)
        return partial(predict_source, opened, network, out, options=options)

    def _why_unrefined(self, options: "PredictOptions", network: "OnnxNetwork") -> str:
        """Return why the room refines no labels of a network by default; "" where it does."""
        from eval.network.predict import fits

        if network.unrefined:
            return f"{self.weights} was measured to be better without; --again refines them"
        if fits(options, network):
            return ""
        own, wanted = network.own.name, (options.scheme or network.usual_scheme).name
        return f"the refinement network does not fit a network of scheme {own!r} and labels of {wanted!r}"


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
    from eval.network.joints.joint_files import KINDS, write_joints

    if joints is not None:
        check_suffix(joints, *KINDS)
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
    people = {"people": write_joints(run.labels, joints)} if joints else {}
    result = {"frames": len(run.labels), "ms_per_frame": round(ms, 2), **people}
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
