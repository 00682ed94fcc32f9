//! The few statistics that experiments need. In: numbers. Out: a number; none where there are too few.

/// Mean of at least one value.
pub(super) fn mean(values: &[f64]) -> Option<f64> {
    (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
}

/// Mean of the magnitudes of at least one value.
pub(super) fn mean_magnitude(values: &[f64]) -> Option<f64> {
    mean(&values.iter().map(|v| v.abs()).collect::<Vec<_>>())
}

/// Root mean square of at least one value.
pub(super) fn rms(values: &[f64]) -> Option<f64> {
    mean(&values.iter().map(|v| v * v).collect::<Vec<_>>()).map(f64::sqrt)
}

/// The largest magnitude of at least one value.
pub(super) fn largest(values: &[f64]) -> Option<f64> {
    values.iter().map(|v| v.abs()).reduce(f64::max)
}

/// Standard deviation of at least two values, about their mean.
pub(super) fn standard_deviation(values: &[f64]) -> Option<f64> {
    let mean = mean(values).filter(|_| values.len() > 1)?;
    let sum: f64 = values.iter().map(|v| (v - mean).powi(2)).sum();
    Some((sum / (values.len() - 1) as f64).sqrt())
}

/// Slope of the straight line that fits `points` best: least squares in y.
pub(super) fn slope(points: &[(f64, f64)]) -> Option<f64> {
    let mx = mean(&points.iter().map(|p| p.0).collect::<Vec<_>>())?;
    let my = mean(&points.iter().map(|p| p.1).collect::<Vec<_>>())?;
    let (xx, xy) = points.iter().fold((0.0, 0.0), |(xx, xy), (x, y)| (xx + (x - mx).powi(2), xy + (x - mx) * (y - my)));
    (xx > 0.0).then_some(xy / xx)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn of_nothing_there_is_nothing() {
        assert_eq!((mean_magnitude(&[]), rms(&[]), largest(&[]), slope(&[(1.0, 1.0)])), (None, None, None, None));
        assert_eq!((mean(&[1.0, 3.0]), largest(&[1.0, -4.0])), (Some(2.0), Some(4.0)));
        assert!((rms(&[3.0, -4.0]).expect("two values") - f64::sqrt(12.5)).abs() < 1e-12);
        assert_eq!(mean_magnitude(&[1.0, -3.0]), Some(2.0));
        assert!((slope(&[(0.0, 1.0), (1.0, 3.0), (2.0, 5.0)]).expect("a line") - 2.0).abs() < 1e-12);
    }
}
