"""Networks of ONNX files, each run by ONNX Runtime on one thread of the processor."""

from typing import TYPE_CHECKING, TypeAlias

if TYPE_CHECKING:
    from onnxruntime import InferenceSession

Network: TypeAlias = "InferenceSession"
"""A network that can be run."""
_NOWHERE = "/dev/null/no-external-data"
"""The folder of tensors outside a file, which does not exist: the file's hash would not cover them, and
their paths are its author's choice."""


def onnx_session(file: bytes) -> Network:
    """The network of a file, which several threads may run at once; loading executes no code from the file.

    Raises ONNX Runtime's errors, which share no public base, where it is no network.
    """
    import onnxruntime  # 0.1 s, which a refusal need not take

    options = onnxruntime.SessionOptions()
    options.add_session_config_entry("session.model_external_initializers_file_folder_path", _NOWHERE)
    options.add_session_config_entry("session.load_model_format", "ONNX")
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.log_severity_level = 4  # whoever catches an error says it in one line
    return onnxruntime.InferenceSession(
        file,
        options,
        providers=["CPUExecutionProvider"],
        enable_fallback=0,  # or it prints, and tries again
    )
