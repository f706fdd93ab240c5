"""Files of anybody's: the one place where they are opened, with limits on what they may hold and ask for.

| module | opens |
|---|---|
| `files` | any file: what it may be, how large; the errors of its library as one InputError |
| `text` | TOML and JSON, of limited depth |
| `archives` | zip archives, of limited members, sizes and compression |
| `arrays` | NPZ |
| `pickles` | the pickled arrays of other codes, by a parser that executes nothing |
| `hdf5` | HDF5 |
| `tensors` | safetensors |
"""
