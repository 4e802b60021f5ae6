"""What texnet is worth, measured. Each file states its command. The map:

accuracy     errors and time of every method against the number of bands; confusion shows which
             materials are mistaken for which
chart        accuracy against time, beside classical methods
speed        seconds and memory, beside what others use
stability    where methods fail, and whether they say so, along difficulties; atlas draws and writes
             it up
knowable     what a pixel can tell whatever the method, in pictures
sigma        whether another sigma of T could have the right coverage
netd         how well the noise is estimated if it is not stated
automatic_k  k by evidence against the best fixed k
band_design  designed filters against equidistant ones
library_from_cube  a library made from the cube alone against the exact one
finetune     what fine-tuning is worth on materials never seen
ablation     what each part of the network and of its loss contributes
other_skies  scenes under skies of LOWTRAN 7; lowtran7 made these, and our sky's coefficients
mitsuba_agreement  the simulator against an independent renderer
reproduce    the paper's figures; paper_method is the paper's method, as written
peers        classical methods, and the usual port of the paper's fit
rows         measurements in files, with their provenance
arguments    for the modules that are commands
threads      the number of threads
colours      for curves
"""

from pathlib import Path

SHIPPED = Path(__file__).parents[1] / "texnet" / "data"
ONNX = SHIPPED / "texnet.onnx"
