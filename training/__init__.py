"""Training on simulated scenes. The map:

vary      other plausible libraries, made from one
scenes    sets of simulated scenes, cached on disk
samples   a scene as some instrument and some library would see it
losses    what is minimised
train     training a network from scratch
reshade   the same scenes, made of another library
crops     a user's own cubes, without truth
finetune  adapting a network to a library or an instrument
workers   processes that leave Ctrl-C to their parent
"""
