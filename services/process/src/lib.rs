//! What every process of the graph does at its start and end.
