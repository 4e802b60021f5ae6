"""Eq. 6 solved exactly, pixel by pixel, and then with smoothness. The map:

reduced     the forward model in r dimensions, and the evidence
simplex     one pixel and hypothesis
faces       where it is known which V are zero, many pixels at once
local       every pixel and material
semiglobal  with smoothness of T and m
distill     the texture that the sky alone lights
"""
