"""One ONNX file instead of a Python stack. The map:

to_onnx  writes TeXModel with its weights into a file (needs torch)
Runtime  (`texnet.runtime`) answers cubes from such a file; needs only numpy and onnxruntime
"""

from texnet.runtime import Runtime

__all__ = ["Runtime"]
