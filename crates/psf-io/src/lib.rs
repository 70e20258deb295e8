//! FITS and table files of psfield: scenes, samples, models, catalogues
