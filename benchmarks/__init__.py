"""Peers side by side, the charts, the paper's figures (`reproduce`). Each file says its command."""

from pathlib import Path

SHIPPED = Path(__file__).parents[1] / "texnet" / "data"
ONNX = SHIPPED / "texnet.onnx"
