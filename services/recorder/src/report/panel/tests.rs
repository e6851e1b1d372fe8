use super::super::axis::Extent;
use super::*;

fn panel() -> Panel {
    let axis = |high| Axis::linear(Extent { low: 0.0, high });
    Panel::new("height [m]", axis(10.0), axis(1.0), Detail::for_records(1))
}

#[test]
fn text_of_a_record_is_never_markup() {
    assert_eq!(
        escape("<script>alert('a' & \"b\")</script>\u{1b}"),
        "&lt;script&gt;alert(&#39;a&#39; &amp; &quot;b&quot;)&lt;/script&gt;\u{fffd}"
    );
    let svg = panel().finish("</title><script>");
    assert!(!svg.contains("<script>"), "{svg}");
}

#[test]
fn the_last_number_of_an_axis_is_inside_the_picture() -> Result<(), Box<dyn std::error::Error>> {
    let axis = |high| Axis::linear(Extent { low: 0.0, high });
    let svg =
        Panel::new("height [m]", axis(3600.0), axis(1.0), Detail::for_records(1)).finish("a test");
    let (before, _) = svg.split_once(">3000</text>").ok_or("no 3000")?;
    let (_, place) = before.rsplit_once("<text x=\"").ok_or("no text")?;
    assert!(place.starts_with("301.3\""), "not at the edge, it stands below its line: {place}");
    let svg =
        Panel::new("height [m]", axis(3000.0), axis(1.0), Detail::for_records(1)).finish("a test");
    let (before, _) = svg.split_once(">3000</text>").ok_or("no 3000")?;
    let (_, place) = before.rsplit_once("<text x=\"").ok_or("no text")?;
    let middle: f64 = place.split_once('"').ok_or("no place")?.0.parse()?;
    assert!(middle + 0.5 * 4.0 * DIGIT <= WIDTH && middle > WIDTH - 5.0 * DIGIT, "{middle}");
    Ok(())
}

#[test]
fn a_line_joins_its_points_and_breaks_where_there_are_none() {
    let mut panel = panel();
    panel.line("r0", 2.0, [(0.0, 0.0), (1.0, 1.0), (2.0, f64::NAN), (3.0, 1.0), (9.0, 0.5)]);
    let svg = panel.finish("a test");
    assert!(svg.contains("d=\"M0 1300l304-1300M912 0h0M2736 650h0\""), "{svg}");
}

#[test]
fn a_band_reaches_as_far_below_as_above() {
    let extent = Extent { low: -1.0, high: 1.0 };
    let mut panel = Panel::new(
        "error",
        Axis::linear(Extent { low: 0.0, high: 10.0 }),
        Axis::linear(extent),
        Detail::for_records(1),
    );
    panel.band("r0", 100.0, [(0.0, 0.5), (10.0, 1.0)]);
    let svg = panel.finish("a test");
    // From +0.5 to +1, down to −1, back to −0.5.
    assert!(svg.contains("d=\"M0 325l3040-325 0 1300-3040-325\""), "{svg}");
}

#[test]
fn the_shortest_bar_is_visible_and_adjacent_bars_are_one() {
    let bars = |every: f64| {
        let mut panel = panel().laned(vec!["brake".into()], 20.0);
        panel.bars(
            "r0",
            0,
            (0, 1),
            (0..100).map(|index| every * f64::from(index)).map(|from| (from, from + 1e-6)),
        );
        panel.finish("a test").matches("h10v").count()
    };
    assert_eq!((bars(0.1), bars(1e-3)), (100, 0));
}
