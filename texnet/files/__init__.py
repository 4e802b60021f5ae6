"""What lies on disk: cubes, libraries, environments, filters, weights. The map:

cube_io      heat cubes (.exr, .npz)
exr_file     OpenEXR files, written
cube_import  third-party cubes (ENVI, HADAR, TeX-1500, .npy)
envi         ENVI's headers and binaries
mat_file     MATLAB's .mat
units        of radiance, however they are written
raw_cube     an array of a file, its unit and its axes -> a HeatCube
library_io   libraries, also third parties' (HADAR .mat, ECOSTRESS, ENVI, CSV)
environment_file  a measured environment, at a cube's bands
text_table   tables of text, as the last two read
wavelengths  as all these files state them, in um and in ascending order
answer_file  decomposition.npz
answer_folder  where an answer is written
band_file    filters, as `texnet bands` designs them
weights      a network's weights
"""
