"""Training on simulated scenes. The map:

vary      other plausible libraries, made from one
scenes    sets of simulated scenes, cached on disk
samples   a scene as some instrument and some library would see it
losses    what is minimised
train     a network from nothing
reshade   the scenes again, made of another library
crops     somebody's own cubes, without truth
finetune  a network gets used to a library or an instrument
workers   processes that leave Ctrl-C to the one that waits for them
"""
