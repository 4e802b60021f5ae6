"""What the physics runs on: files, read-only values, threads, tiles, compiled loops. The map:

whole_file  a file is written whole or not at all
json_file   JSON that people write
array_file  named arrays in one file
provenance  what made a result that is kept on disk
scratch     large arrays in files without a name
read_only   values whose arrays stay read-only when they are copied
threads     many items, some at a time
tiles       pictures of any size in tiles
compiled    loops compiled by numba
blas        BLAS's own threads, where they would be in the way
"""
