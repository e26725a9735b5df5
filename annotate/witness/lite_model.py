"""Networks of TFLite files, run by LiteRT."""

import threading

from annotate.array_types import Float32
from sensors.errors import CloudError


class LiteModel:
    """Network that LiteRT runs on one thread; several threads may call it.

    Raises CloudError without the extra ``colour``.
    """

    def __init__(self, data: bytes) -> None:
        try:
            from ai_edge_litert.interpreter import Interpreter
        except ImportError as error:
            raise CloudError(
                "ai_edge_litert is not installed; pip install 'annotate-cloud[colour]'"
            ) from error
        self._net = Interpreter(model_content=data, num_threads=1)
        self._net.allocate_tensors()
        self._in = self._net.get_input_details()[0]["index"]
        self._out = {out["name"]: out["index"] for out in self._net.get_output_details()}
        self._one = threading.Lock()

    def __call__(self, image: Float32) -> dict[str, Float32]:
        """Return the outputs without their first axis by name, for an image (h, w, 3)."""
        with self._one:
            self._net.set_tensor(self._in, image[None])
            self._net.invoke()
            return {name: self._net.get_tensor(index)[0] for name, index in self._out.items()}
