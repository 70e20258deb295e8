#![no_main]

psfield_fuzz::fuzz!(psfield_fuzz::targets::curve);
