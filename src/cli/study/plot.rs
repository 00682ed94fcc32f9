//! One plot as SVG. In: curves. Out: an `<svg>` element. Not here: what they mean.

use crate::study::Plot;
use plotters::prelude::*;

const SIZE: (u32, u32) = (760, 380);
/// With more curves than this a legend says nothing.
const LEGEND: usize = 8;

/// Told apart also by those who cannot tell red from green: Okabe and Ito, "Color Universal Design", 2008.
const COLOURS: [RGBColor; 7] = [
    RGBColor(0, 114, 178),
    RGBColor(213, 94, 0),
    RGBColor(0, 158, 115),
    RGBColor(204, 121, 167),
    RGBColor(86, 180, 233),
    RGBColor(230, 159, 0),
    RGBColor(60, 60, 60),
];

/// None where there is nothing to draw.
pub(super) fn svg(plot: &Plot) -> Option<String> {
    let points = || plot.series.iter().flat_map(|s| s.points.iter().copied());
    points().next()?;
    let x = range(points().map(|p| p.0));
    let y = range(points().map(|p| p.1).chain(plot.levels.iter().copied()));
    let mut out = String::new();
    draw(plot, x, y, &mut out).expect("a string takes all that is drawn");
    Some(out)
}

/// A little more than the values take.
fn range(values: impl Iterator<Item = f64>) -> std::ops::Range<f64> {
    let (low, high) = values.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(v), h.max(v)));
    let room = if high > low { 0.05 * (high - low) } else { 1.0 };
    low - room..high + room
}

fn draw(
    plot: &Plot,
    x: std::ops::Range<f64>,
    y: std::ops::Range<f64>,
    out: &mut String,
) -> Result<(), Box<dyn std::error::Error>> {
    let area = SVGBackend::with_string(out, SIZE).into_drawing_area();
    let mut chart = ChartBuilder::on(&area)
        .margin(8)
        .x_label_area_size(40)
        .y_label_area_size(64)
        .build_cartesian_2d(x.clone(), y)?;
    chart
        .configure_mesh()
        .x_desc(&plot.x)
        .y_desc(&plot.y)
        .light_line_style(WHITE)
        .label_style(("sans-serif", 13))
        .draw()?;
    for level in &plot.levels {
        chart.draw_series(LineSeries::new([(x.start, *level), (x.end, *level)], RED.mix(0.6)))?;
    }
    let legend = plot.series.len() <= LEGEND && plot.series.len() > 1;
    for (series, colour) in plot.series.iter().zip(COLOURS.iter().cycle()) {
        if series.joined {
            chart.draw_series(LineSeries::new(series.points.iter().copied(), colour))?;
        }
        let dots = series.points.iter().map(|p| Circle::new(*p, 2, colour.filled()));
        let drawn = chart.draw_series(dots)?;
        if legend {
            drawn.label(&series.name).legend(move |at| Circle::new(at, 4, colour.filled()));
        }
    }
    if legend {
        let at = SeriesLabelPosition::UpperRight;
        let style = ("sans-serif", 13);
        chart.configure_series_labels().position(at).background_style(WHITE.mix(0.8)).label_font(style).draw()?;
    }
    drop(chart);
    area.present()?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::study::Series;

    #[test]
    fn curves_become_svg_and_nothing_becomes_none() {
        let series = |points: Vec<(f64, f64)>| Series { name: "a < b".into(), points, joined: true };
        let mut plot = Plot {
            title: "t".into(),
            x: "turned, °".into(),
            y: "mm".into(),
            series: vec![series(vec![(0.0, 0.0), (1.0, 2.0)]), series(vec![(0.5, 1.0)])],
            levels: vec![1.0],
        };
        let drawn = svg(&plot).expect("something");
        assert!(drawn.starts_with("<svg") && drawn.trim_end().ends_with("</svg>"), "{drawn}");
        assert!(drawn.contains("<polyline") && drawn.contains("turned, °") && drawn.contains("a &lt; b"), "{drawn}");
        plot.series = vec![series(Vec::new())];
        assert!(svg(&plot).is_none());
    }
}
