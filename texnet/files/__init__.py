"""Files on disk: cubes, libraries, environments, filters, weights. The map:

cube_io      heat cubes (.exr, .npz)
exr_file     writing OpenEXR files
cube_import  third-party cubes (ENVI, HADAR, TeX-1500, .npy)
envi         ENVI's headers and binaries
mat_file     MATLAB's .mat
units        units of radiance in all spellings
raw_cube     a file's array, its unit and its axes -> a HeatCube
library_io   libraries, also from third parties (HADAR .mat, ECOSTRESS, ENVI, CSV)
environment_file  a measured environment, at a cube's bands
text_table   tables of text, used by the last two
wavelengths  wavelengths as these files state them, in um and in ascending order
answer_file  decomposition.npz
answer_folder  where an answer is written
band_file    filters, as designed by `texnet bands`
weights      a network's weights
"""
