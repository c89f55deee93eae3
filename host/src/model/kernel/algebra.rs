//! Kernels from the algebra they print as.
//!
//! ```text
//! kernel = term { "+" term }
//! term   = [number] factor
//! factor = "I" "(" scalar ")" | "M" "(" number ")" "(" scalar ")" | "(" kernel ")"
//!        | "[" kernel "]" "." ("mirrored" | "mirrored_displacement") "(" axis "," number ")"
//! scalar = [number] gaussian { "+" [number] gaussian }
//! gaussian = ("rbf" | "rgb_rbf") "(" number ")"
//! ```

use super::{Gaussian, Kernel, Scalar, Space};
use crate::error::{Error, Result};
use crate::mesh::Axis;
use std::str::FromStr;

/// Brackets within brackets that a kernel may have.
const DEPTH: usize = 32;

impl FromStr for Kernel {
    type Err = Error;

    /// Parses what a kernel displays as, like
    /// `[I (7 rbf(100) + 3 rbf(10))].mirrored_displacement(x, 0.7)`.
    ///
    /// # Errors
    /// What does not parse, with its column; numbers for which the kernel is no covariance.
    fn from_str(text: &str) -> Result<Self> {
        let mut parser = Parser { text, at: 0 };
        let kernel = parser.kernel(0)?;
        if parser.peek().is_some() {
            return Err(parser.fault("the end, or `+`"));
        }
        Ok(kernel)
    }
}

struct Parser<'t> {
    text: &'t str,
    at: usize,
}

impl Parser<'_> {
    fn kernel(&mut self, depth: usize) -> Result<Kernel> {
        let mut kernel = self.term(depth)?;
        while self.eat("+") {
            kernel = kernel + self.term(depth)?;
        }
        Ok(kernel)
    }

    fn term(&mut self, depth: usize) -> Result<Kernel> {
        if depth > DEPTH {
            return Err(self.fault("fewer brackets within brackets"));
        }
        if self.peek().is_some_and(|c| c.is_ascii_digit() || "+-.".contains(c)) {
            let factor = self.number(0.0..=f64::MAX, "a factor that is not negative")?;
            return Ok(factor * self.factor(depth)?);
        }
        self.factor(depth)
    }

    fn factor(&mut self, depth: usize) -> Result<Kernel> {
        if self.eat("(") {
            let kernel = self.kernel(depth + 1)?;
            self.expect(")")?;
            Ok(kernel)
        } else if self.eat("[") {
            let kernel = self.kernel(depth + 1)?;
            self.expect("]")?;
            self.expect(".")?;
            // The longer name first: it begins like the other.
            let displacement = self.eat("mirrored_displacement");
            if !displacement {
                self.expect("mirrored")?;
            }
            self.expect("(")?;
            let axis = self.axis()?;
            self.expect(",")?;
            let alpha = self.number(-1.0..=1.0, "a correlation from -1 to 1")?;
            self.expect(")")?;
            let inner = Box::new(kernel);
            Ok(Kernel::Mirrored { inner, axis, alpha, displacement })
        } else if self.eat("I") {
            Ok(self.scalar()?.identity())
        } else if self.eat("M") {
            self.expect("(")?;
            let beta = self.number(-0.5..=1.0, "a correlation from -0.5 to 1")?;
            self.expect(")")?;
            Ok(self.scalar()?.correlated(beta))
        } else {
            Err(self.fault("`I (`, `M(`, `(` or `[`"))
        }
    }

    /// A scalar kernel in brackets.
    fn scalar(&mut self) -> Result<Scalar> {
        self.expect("(")?;
        let mut sum = vec![self.gaussian()?];
        while self.eat("+") {
            sum.push(self.gaussian()?);
        }
        self.expect(")")?;
        Ok(Scalar(sum))
    }

    fn gaussian(&mut self) -> Result<Gaussian> {
        let positive = f64::MIN_POSITIVE..=f64::MAX;
        let named = self.peek().is_some_and(|c| c == 'r');
        let weight = if named { 1.0 } else { self.number(positive.clone(), "a variance")? };
        let space = if self.eat("rgb_rbf") {
            Space::Color
        } else {
            self.expect("rbf")?;
            Space::Position
        };
        self.expect("(")?;
        let sigma = self.number(positive, "a scale above zero")?;
        self.expect(")")?;
        Ok(Gaussian { weight, sigma, space })
    }

    fn axis(&mut self) -> Result<Axis> {
        let axis = [("x", Axis::X), ("y", Axis::Y), ("z", Axis::Z)]
            .into_iter()
            .find_map(|(name, axis)| self.eat(name).then_some(axis));
        axis.ok_or_else(|| self.fault("an axis, x, y or z"))
    }

    fn number(&mut self, range: std::ops::RangeInclusive<f64>, what: &str) -> Result<f64> {
        self.peek();
        let rest = &self.text[self.at..];
        let numeric = |(i, c): &(usize, char)| {
            let after_e = *i > 0 && rest[..*i].ends_with(['e', 'E']);
            c.is_ascii_digit() || ".eE".contains(*c) || ("+-".contains(*c) && (*i == 0 || after_e))
        };
        let length = rest.char_indices().take_while(numeric).count();
        match rest[..length].parse() {
            Ok(number) if range.contains(&number) => {
                self.at += length;
                Ok(number)
            }
            _ => Err(self.fault(what)),
        }
    }

    /// The next character that is no space.
    fn peek(&mut self) -> Option<char> {
        let rest = &self.text[self.at..];
        self.at += rest.len() - rest.trim_start().len();
        self.text[self.at..].chars().next()
    }

    fn eat(&mut self, token: &str) -> bool {
        self.peek();
        let found = self.text[self.at..].starts_with(token);
        self.at += if found { token.len() } else { 0 };
        found
    }

    fn expect(&mut self, token: &str) -> Result<()> {
        if self.eat(token) { Ok(()) } else { Err(self.fault(&format!("`{token}`"))) }
    }

    fn fault(&mut self, expected: &str) -> Error {
        self.peek();
        let column = self.text[..self.at].chars().count() + 1;
        let found: String = self.text[self.at..].chars().take(12).collect();
        Error::new(format_args!(
            "column {column}: found {found:?}, expected {expected}; a kernel is written like \
             [I (7 rbf(100) + 3 rbf(10))].mirrored_displacement(x, 0.7)"
        ))
    }
}

#[cfg(test)]
mod tests {
    use super::super::{Hyper, KERNELS};
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn every_kernel_of_the_paper_parses_from_what_it_prints() {
        for named in &KERNELS {
            for mirror in [None, Some(Axis::X), Some(Axis::Z)] {
                let kernel = named.kernel(&Hyper::default(), mirror);
                assert_eq!(kernel.to_string().parse::<Kernel>(), Ok(kernel));
            }
        }
    }

    #[test]
    fn what_is_no_kernel_is_refused_with_its_column() {
        for (text, expected) in [
            ("", "column 1"),
            ("I (7 rbf(100)", "column 14: found \"\", expected `)`"),
            ("I (7 rbf(0))", "column 10"),
            ("I (-7 rbf(1))", "a variance"),
            ("M(2) (rbf(1))", "column 3: found \"2) (rbf(1))\", expected a correlation"),
            ("[I (rbf(1))].mirrored(w, 1)", "an axis"),
            ("I (rbf(1)) I", "the end"),
            ("-1 (I (rbf(1)))", "a factor"),
            ("I (1e999 rbf(1))", "a variance"),
            ("é", "column 1"),
        ] {
            let error = text.parse::<Kernel>().unwrap_err().to_string();
            assert!(error.contains(expected), "{text:?} gives {error:?}");
        }
        let nested = "(".repeat(100_000) + "I (rbf(1))";
        assert!(nested.parse::<Kernel>().is_err());
    }

    proptest! {
        #[test]
        fn any_text_parses_or_gives_an_error(text in "[IM()\\[\\].+rgb_f mixedacp,0-9e-]{0,40}") {
            let _ = text.parse::<Kernel>();
        }
    }
}
