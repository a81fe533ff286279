//! Networks, layers and optimizers on libtorch.
