//! Columns of numbers together with where each comes from.

use crate::Metric;

/// Columns, each with how its number comes out of a row of an evaluation: heads and values cannot come apart.
pub struct Columns<R>(Vec<(Metric, Value<R>)>);

type Value<R> = Box<dyn Fn(&R) -> f64>;

impl<R> Default for Columns<R> {
    fn default() -> Self {
        Self(Vec::new())
    }
}

impl<R> Columns<R> {
    /// With one column more.
    pub fn with(mut self, metric: Metric, value: impl Fn(&R) -> f64 + 'static) -> Self {
        self.0.push((metric, Box::new(value)));
        self
    }

    /// With one column more, if `has` it.
    pub fn with_if(self, has: bool, metric: Metric, value: impl Fn(&R) -> f64 + 'static) -> Self {
        if has { self.with(metric, value) } else { self }
    }

    /// What they are.
    pub fn metrics(&self) -> Vec<Metric> {
        self.0.iter().map(|(metric, _)| metric.clone()).collect()
    }

    /// What a row has in them.
    pub fn values(&self, row: &R) -> Vec<f64> {
        self.0.iter().map(|(_, value)| value(row)).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_value_stands_below_its_head() {
        let columns = Columns::default()
            .with(Metric::higher("IoU", "unirig", 4), |row: &[f64; 2]| row[1])
            .with_if(false, Metric::lower("clips", "unirig", 4), |_| f64::NAN)
            .with_if(true, Metric::lower("L1", "unirig", 5), |row| 2.0 * row[0]);
        let names: Vec<_> = columns.metrics().into_iter().map(|m| m.name).collect();
        assert_eq!((names, columns.values(&[3.0, 0.5])), (vec!["IoU".into(), "L1".into()], vec![0.5, 6.0]));
    }
}
