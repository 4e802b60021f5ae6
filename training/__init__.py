"""Training on simulated scenes. The map:

vary    other plausible libraries, made from one
scenes  sets of simulated scenes, cached on disk
"""
