//! HDF5 corpora of rigs, splits and the loader.
