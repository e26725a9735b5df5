"""Networks of ONNX files, run by ONNX Runtime on one thread."""

import json
from collections.abc import Mapping
from typing import TYPE_CHECKING, TypeAlias

from annotate.scheme.scheme import Scheme
from annotate.scheme.scheme_file import scheme_from_fields
from sensors.errors import FormatError

if TYPE_CHECKING:
    from onnxruntime import InferenceSession

Network: TypeAlias = "InferenceSession"
SCHEME = "scheme"
"""Metadata entry of an ONNX file: its network's scheme as JSON. A file of ``paper`` has none."""
REFINEMENT, WITHOUT = "refinement", "without"
"""Metadata entry of a depth network whose labels are better without refinement, and its value."""
_NOWHERE = "/dev/null/no-external-data"
"""Absent folder of external tensors, because the file's hash would not cover them."""


def onnx_session(file: bytes) -> Network:
    """Load the network of an ONNX file's bytes without executing code from it. Any number of threads may run
    it.

    Raises ONNX Runtime's errors, which share no base class, if the bytes hold no valid ONNX network.
    """
    import onnxruntime  # 0.1 s

    options = onnxruntime.SessionOptions()
    options.add_session_config_entry("session.model_external_initializers_file_folder_path", _NOWHERE)
    options.add_session_config_entry("session.load_model_format", "ONNX")
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.log_severity_level = 4  # because the caller reports errors
    return onnxruntime.InferenceSession(
        file,
        options,
        providers=["CPUExecutionProvider"],
        enable_fallback=0,  # because a fallback prints
    )


def scheme_in_metadata(metadata: Mapping[str, str]) -> Scheme | None:
    """Return the scheme in an ONNX file's metadata, None without one. Raises FormatError for a malformed
    one.
    """
    if SCHEME not in metadata:
        return None
    try:
        return scheme_from_fields(json.loads(metadata[SCHEME]))
    except (ValueError, RecursionError) as error:
        raise FormatError(f"metadata {SCHEME} is malformed ({error}); export the network again") from error
