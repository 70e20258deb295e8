//! Images with a point spread function that varies over the field: the pipeline and the command line
