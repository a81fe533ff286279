//! The tasks: where data, network, loss and evaluation meet.
