"""Networks of ONNX files, run by ONNX Runtime on one thread."""

from typing import TYPE_CHECKING, TypeAlias

if TYPE_CHECKING:
    from onnxruntime import InferenceSession

Network: TypeAlias = "InferenceSession"
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
