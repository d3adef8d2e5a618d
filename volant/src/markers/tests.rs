use super::*;
use rig_model::Rig;

fn rig(side: f64) -> Rig {
    let mut rig = Rig::from_yaml(include_str!("../../../launch_config/config/rig.yaml")).unwrap();
    rig.markers.side = side;
    rig
}

fn rectangles(sheet: &Sheet) -> Vec<([f64; 2], [f64; 2])> {
    let of = |m: &Mark| match m {
        Mark::Rectangle { at, size, .. } => Some((*at, *size)),
        _ => None,
    };
    sheet.marks.iter().filter_map(of).collect()
}

#[test]
fn squares_are_at_scale_within_the_paper_and_apart() {
    for paper in [Paper::A4, Paper::A3, Paper::LETTER] {
        for (side, sheets_of_squares) in [(0.04, 1), (0.076, 1), (0.12, 4)] {
            let sheets = sheets(&rig(side), &paper, None).unwrap();
            if paper == Paper::A4 {
                assert_eq!(sheets.len(), sheets_of_squares + 2, "{side}");
            }
            let all: Vec<_> = sheets[..sheets.len() - 2].iter().map(rectangles).collect();
            assert_eq!(all.iter().map(Vec::len).sum::<usize>(), 4);
            for on_one in &all {
                for (i, (at, size)) in on_one.iter().enumerate() {
                    assert!(size.iter().all(|s| (s - 1e3 * side).abs() < 1e-9));
                    assert!(at.iter().all(|v| *v > 12.0));
                    assert!(at[0] + size[0] < paper.width - 12.0);
                    assert!(at[1] + size[1] < paper.height - 30.0, "the bar is below");
                    for (other, _) in &on_one[..i] {
                        let gap = (0..2).map(|k| (at[k] - other[k]).abs() - size[k]);
                        assert!(gap.fold(f64::MIN, f64::max) > 15.9);
                    }
                }
            }
            for text in sheets.iter().flat_map(|s| &s.marks) {
                let Mark::Text { text, at, size, align } = text else { continue };
                let width = 0.5 * size * text.len() as f64;
                let end = at[0] + if *align == Align::Middle { width / 2.0 } else { width };
                assert!(text.is_ascii() && end < paper.width - 5.0, "{text} ends at {end} mm");
            }
        }
    }
}

#[test]
fn a_square_larger_than_the_paper_is_refused_with_the_remedy() {
    let error = sheets(&rig(0.2), &Paper::A4, None).unwrap_err().to_string();
    assert!(error.contains("200 mm") && error.contains("--page a3"), "{error}");
    assert_eq!(sheets(&rig(0.2), &Paper::A3, None).unwrap().len(), 6);
}

#[test]
fn the_drawing_shows_the_layout_and_its_distances() {
    let sheets = sheets(&rig(0.076), &Paper::A4, Some(500.0)).unwrap();
    let [.., drawing, advice] = sheets.as_slice() else { panic!() };
    let squares = rectangles(drawing);
    // Red is right of green and above yellow; a square's side is to their distance as 76 to 300.
    let distance = squares[0].0[0] - squares[1].0[0];
    assert!((distance / squares[0].1[0] - 300.0 / 76.0).abs() < 1e-9);
    assert!((squares[3].0[1] - squares[0].0[1] - distance).abs() < 1e-9);
    let has = |sheet: &Sheet, what: &str| {
        sheet.marks.iter().any(|m| matches!(m, Mark::Text { text, .. } if text.contains(what)))
    };
    assert!(has(drawing, "blue (-150.0, -150.0, 20.0)"));
    assert!(has(drawing, "red - green: 300.0 mm") && has(drawing, "red - blue: 424.3 mm"));
    // 500 px · 76 mm / 2 m, and 20 px · 2 m / 500 px.
    assert!(has(advice, "19 px !  (80 mm)") && has(advice, "f = 500 px"));
}

#[test]
fn the_pdf_has_a_page_per_sheet_and_the_square_in_points() {
    let sheets = sheets(&rig(0.076), &Paper::A4, None).unwrap();
    let pdf = pdf(&sheets, &Paper::A4);
    let text = String::from_utf8_lossy(&pdf);
    assert!(text.starts_with("%PDF-1.") && text.trim_end().ends_with("%%EOF"));
    assert_eq!(text.matches("/Type /Page\n").count(), sheets.len());
    assert!(text.contains("/MediaBox [0 0 595.27") && text.contains("841.8"));
    let sides: Vec<f64> = text
        .lines()
        .filter_map(|l| l.strip_suffix(" re"))
        .filter_map(|l| l.split(' ').nth(2)?.parse().ok())
        .collect();
    let at_scale = sides.iter().filter(|s| (*s - 76.0 * 72.0 / 25.4).abs() < 1e-3).count();
    assert_eq!(at_scale, 4, "{sides:?}");
    let svg = svg(&sheets, &Paper::A4);
    assert_eq!(svg.matches("width=\"76.000\" height=\"76.000\"").count(), 4);
    assert!(svg.contains("width=\"210mm\""));
}

#[test]
fn the_pdf_has_one_code_per_character_of_a_text() {
    let text = "K\u{e4}fig \u{1f680}".to_owned();
    let mark = Mark::Text { at: [10.0; 2], size: 4.0, align: Align::Start, text };
    let pdf = pdf(&[Sheet { marks: vec![mark] }], &Paper::A4);
    let pdf = String::from_utf8_lossy(&pdf);
    assert!(pdf.contains("/Encoding /WinAnsiEncoding"), "{pdf}");
    // In hexadecimal digits, since it is no ASCII text.
    let codes: String = b"K\xe4fig ?".iter().map(|code| format!("{code:02X}")).collect();
    assert!(pdf.contains(&format!("<{codes}>")), "{codes}: {pdf}");
}
