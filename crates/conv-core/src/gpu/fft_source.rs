//! Generates the source text of one-dimensional transforms in a workgroup's memory.
//!
//! The transforms use Stockham's algorithm with radices 3, 4, 5 and 8. Their input and output are
//! in natural order. A stage consists of *butterflies*, which are transforms of `radix` values. It
//! reads each butterfly's values, which lie `n / radix` apart, multiplies them by the roots of
//! unity, transforms them and writes the results in the order that the next stage needs. Between
//! stages values pass through the memory that the workgroup shares. The shader supplies the code
//! that loads the values of the first stage, and the last stage leaves its results in registers. So
//! loading values, multiplying spectra and storing results need no extra pass.
//!
//! A product of spectra is computed in registers, and the transform back begins with the values in
//! the registers where the forward transform left them. The transform back uses the radices in
//! reverse order. So its first stage has the radix of the forward transform's last stage, and each
//! thread already has the values that it needs.

use std::fmt::Write as _;

/// Several transforms of one length that a workgroup computes together.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct FftSource {
    /// The length.
    pub(super) n: usize,
    /// The number of lines (rows or columns of a plane) that are transformed together.
    pub(super) lines: usize,
    /// Threads of the workgroup.
    pub(super) threads: usize,
    /// True if neighbouring threads work on neighbouring lines (for columns), false if they work on
    /// neighbouring values of one line (for rows).
    interleaved: bool,
    radices: Vec<usize>,
    /// True if the shared memory has room for the gaps that [`padded`] explains.
    padded: bool,
}

/// The most values per workgroup, unless a single transform is longer. They are enough to hide
/// memory latency, and few enough for several workgroups to share one core of the GPU.
const VALUES: usize = 2048;
/// The number of values per thread.
const VALUES_PER_THREAD: usize = 8;
/// The most lines per workgroup. The values of 16 neighbouring columns in a row are 128 bytes,
/// which many GPUs read at once.
const MOST_LINES: usize = 16;
/// The most threads. The WebGPU standard requires that adapters support this number.
const MOST_THREADS: usize = 256;
/// Bytes of a complex value.
const BYTES: usize = 8;

impl FftSource {
    /// Transforms of `n` values, a multiple of 16 without prime factors above 5, for a workgroup
    /// with `memory` bytes and at most `most_threads` threads. Returns `None` if a single transform
    /// does not fit, or for any other `n`.
    pub(super) fn new(n: usize, interleaved: bool, memory: usize, most_threads: usize) -> Option<Self> {
        let room = memory / BYTES;
        if n > room {
            return None;
        }
        let mut lines = MOST_LINES;
        while lines > 1 && lines * n > VALUES.min(room) {
            lines /= 2;
        }
        let values = lines * n;
        Some(Self {
            n,
            lines,
            threads: (values / VALUES_PER_THREAD).min(MOST_THREADS).min(most_threads),
            interleaved,
            radices: radices(n)?,
            padded: padded(values) <= room,
        })
    }

    /// The longest transform for a workgroup with `memory` bytes.
    pub(super) fn longest(memory: usize) -> usize {
        memory / BYTES / 16 * 16
    }

    /// The number of values in the memory that the workgroup shares.
    pub(super) fn shared(&self) -> usize {
        let values = self.lines * self.n;
        if self.padded { padded(values) } else { values }
    }

    /// The numbers in `transforms.wgsl`, with their names.
    pub(super) fn numbers(&self) -> [(&'static str, usize); 6] {
        let (line_step, index_step) = if self.interleaved {
            (1, self.lines)
        } else {
            (self.n, 1)
        };
        [
            ("THREADS", self.threads),
            ("LINES", self.lines),
            ("SHARED", self.shared()),
            ("LINE_STEP", line_step),
            ("INDEX_STEP", index_step),
            ("PADDED", self.padded.into()),
        ]
    }

    /// Declares registers with a given name, set to zero.
    pub(super) fn registers(&self, name: &str) -> String {
        let of_stage = |&radix: &usize| (self.lines * self.n / radix).div_ceil(self.threads) * radix;
        let count = self.radices.iter().map(of_stage).max().unwrap_or(0);
        let register = |i: usize| format!("var {name}{i} = vec2f(0.0);\n");
        (0..count).map(register).collect()
    }

    /// The code of a transform in registers `v`. The shader's `load(line, index)` returns an input
    /// value.
    pub(super) fn forward(&self) -> String {
        self.at_each(self.radices[0], "v# = load(line, index);") + &self.stages(self.radices.iter().copied())
    }

    /// The code of the transform back. It begins with values in the registers `v`, in the places
    /// that [`each_result`](Self::each_result) names. The shader swaps real and imaginary parts
    /// before and after it: the forward transform of swapped values is the swapped transform back.
    /// [`each_result_back`](Self::each_result_back) names the places of the results.
    pub(super) fn back_of_swapped(&self) -> String {
        self.stages(self.radices.iter().rev().copied())
    }

    /// A statement for each result of a transform, as for [`at_each`](Self::at_each).
    pub(super) fn each_result(&self, statement: &str) -> String {
        self.at_each(self.radices[self.radices.len() - 1], statement)
    }

    /// A statement for each result of a transform back.
    pub(super) fn each_result_back(&self, statement: &str) -> String {
        self.at_each(self.radices[0], statement)
    }

    fn stages(&self, radices: impl Iterator<Item = usize>) -> String {
        let mut text = String::new();
        let mut done = 1;
        for radix in radices {
            let length = done * radix;
            if done > 1 {
                // Reads the values that the stage before wrote.
                text += &self.at_each(radix, "v# = shared_values[slot(line, index)];");
            }
            text += &self.butterflies(radix, done);
            if length < self.n {
                text += "workgroupBarrier();\n";
                text += &self.at_each_butterfly(radix, |first| {
                    let mut text = format!("let to = (b / {done}u) * {length}u + b % {done}u;\n");
                    for r in 0..radix {
                        let (from, place) = (first + r, r * done);
                        let _ = writeln!(text, "shared_values[slot(line, to + {place}u)] = v{from};");
                    }
                    text
                });
                text += "workgroupBarrier();\n";
            }
            done = length;
        }
        text
    }

    /// The code of a stage's butterflies. From the second stage on, it first multiplies each value
    /// by its root of unity. `done` is the product of the radices of the earlier stages.
    fn butterflies(&self, radix: usize, done: usize) -> String {
        let step = self.n / (done * radix);
        self.at_each_butterfly(radix, |first| {
            let mut text = String::new();
            if done > 1 {
                let _ = writeln!(text, "let turn = (b % {done}u) * {step}u;");
                for r in 1..radix {
                    let _ = writeln!(text, "v{0} = times(v{0}, roots[{r}u * turn]);", first + r);
                }
            }
            let names: Vec<String> = (0..radix).map(|r| format!("v{}", first + r)).collect();
            text + &butterfly(&names)
        })
    }

    /// A statement for each value of each butterfly of a radix. In the statement, `line` and `index`
    /// are the place of the value, and `#` stands for the number of its register.
    fn at_each(&self, radix: usize, statement: &str) -> String {
        let step = self.n / radix;
        self.at_each_butterfly(radix, |first| {
            let value = |r: usize| {
                let statement = statement.replace('#', &(first + r).to_string());
                format!("{{ let index = b + {}u; {statement} }}\n", r * step)
            };
            (0..radix).map(value).collect()
        })
    }

    /// Code with which each thread computes its butterflies. `text` gets the number of the first
    /// register. In the text, `b` is the number of the butterfly along the line `line`.
    fn at_each_butterfly(&self, radix: usize, text: impl Fn(usize) -> String) -> String {
        let along = self.n / radix;
        let count = self.lines * along;
        let (line, b) = if self.interleaved {
            (format!("u % {}u", self.lines), format!("u / {}u", self.lines))
        } else {
            (format!("u / {along}u"), format!("u % {along}u"))
        };
        let round = |round: usize| {
            let first = round * self.threads;
            let condition = if first + self.threads > count {
                format!("if (thread + {first}u < {count}u) ")
            } else {
                String::new()
            };
            let text = text(round * radix);
            format!("{condition}{{\nlet u = thread + {first}u;\nlet line = {line};\nlet b = {b};\n{text}}}\n")
        };
        (0..count.div_ceil(self.threads)).map(round).collect()
    }
}

/// Returns the number of places for some values if one place in nine is left empty. Neighbouring
/// threads then access different banks of the memory for any radix.
fn padded(values: usize) -> usize {
    values + values / 8
}

/// The radices of a length, with 3 and 5 in the middle. `None` if the length is not a multiple of
/// 16, or has a prime factor above 5.
fn radices(n: usize) -> Option<Vec<usize>> {
    let mut rest = n;
    let mut odd = Vec::new();
    for radix in [5, 3] {
        while rest.is_multiple_of(radix) {
            odd.push(radix);
            rest /= radix;
        }
    }
    if !rest.is_power_of_two() || rest < 16 {
        return None;
    }
    let twos = rest.trailing_zeros() as usize;
    let mut even = match twos % 3 {
        0 => vec![8; twos / 3],
        // Divides 16 into 4 x 4, because there is no radix 2.
        1 => [vec![8; (twos - 4) / 3], vec![4, 4]].concat(),
        _ => [vec![8; (twos - 2) / 3], vec![4]].concat(),
    };
    let last = even.pop()?;
    even.extend(odd);
    even.push(last);
    Some(even)
}

/// The code of a transform of a few values in place, `sum_j v_j exp(-2 pi i j k / n)`.
fn butterfly(v: &[String]) -> String {
    match v {
        [a, b, c] => format!(
            "{{ let sum = {b} + {c}; let rest = {a} - 0.5 * sum; let d = turned({:?} * ({b} - {c}));\n\
             {a} = {a} + sum; {b} = rest + d; {c} = rest - d; }}\n",
            f32::sqrt(0.75)
        ),
        [a, b, c, d] => format!(
            "{{ let p = {a} + {c}; let q = {a} - {c}; let r = {b} + {d}; let s = turned({b} - {d});\n\
             {a} = p + r; {b} = q + s; {c} = p - r; {d} = q - s; }}\n"
        ),
        [a, b, c, d, e] => {
            let angle = std::f64::consts::TAU / 5.0;
            let (c1, c2) = (angle.cos() as f32, (2.0 * angle).cos() as f32);
            let (s1, s2) = (angle.sin() as f32, (2.0 * angle).sin() as f32);
            format!(
                "{{ let p = {b} + {e}; let q = {c} + {d}; let r = {b} - {e}; let s = {c} - {d};\n\
                 let m = {a} + {c1:?} * p + {c2:?} * q; let n = {a} + {c2:?} * p + {c1:?} * q;\n\
                 let g = turned({s1:?} * r + {s2:?} * s); let h = turned({s2:?} * r - {s1:?} * s);\n\
                 {a} = {a} + p + q; {b} = m + g; {c} = n + h; {d} = n - h; {e} = m - g; }}\n"
            )
        }
        _ => {
            // Combines two transforms of four values: of the even indices and of the odd indices.
            let pick =
                |first: usize| -> Vec<String> { (first..8).step_by(2).map(|i| v[i].clone()).collect() };
            let (even, odd) = (pick(0), pick(1));
            let half = std::f32::consts::FRAC_1_SQRT_2;
            let mut text = butterfly(&even) + &butterfly(&odd);
            let _ = write!(
                text,
                "{{ let e0 = {0}; let e1 = {2}; let e2 = {4}; let e3 = {6};\n\
                 let o0 = {1}; let o1 = {half:?} * ({3} + turned({3})); let o2 = turned({5}); let o3 = {half:?} * (turned({7}) - {7});\n\
                 {0} = e0 + o0; {4} = e0 - o0; {1} = e1 + o1; {5} = e1 - o1;\n\
                 {2} = e2 + o2; {6} = e2 - o2; {3} = e3 + o3; {7} = e3 - o3; }}\n",
                v[0], v[1], v[2], v[3], v[4], v[5], v[6], v[7]
            );
            text
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn radices_multiply_to_the_length() {
        for n in [
            16, 32, 48, 64, 80, 96, 128, 144, 240, 256, 320, 400, 512, 640, 1024, 2048,
        ] {
            let radices = radices(n).unwrap();
            assert_eq!(radices.iter().product::<usize>(), n);
            assert!(radices.len() > 1, "{n}: a product needs two stages");
        }
        assert_eq!(radices(7 * 16), None);
        assert_eq!(radices(8), None);
    }

    #[test]
    fn workgroups_fit_their_memory() {
        for (n, memory, lines, padded) in [
            (256, 32 << 10, 8, true),
            (2048, 32 << 10, 1, true),
            (2048, 16 << 10, 1, false),
            (4096, 32 << 10, 1, false),
            (16, 32 << 10, 16, true),
        ] {
            let fft = FftSource::new(n, true, memory, 256).unwrap();
            assert_eq!((fft.lines, fft.padded), (lines, padded), "{n} in {memory}");
            assert!(fft.shared() * BYTES <= memory && fft.threads <= 256);
        }
        assert_eq!(FftSource::new(4096, true, 16 << 10, 256), None);
        assert_eq!(FftSource::longest(16 << 10), 2048);
    }
}
