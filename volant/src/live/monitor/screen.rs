//! Draws a snapshot on a terminal.

use super::{
    plain::{self, Tone, flow_cells, input_line, level, nothing, rig_lines},
    snapshot::{RigState, Snapshot},
};
use ratatui::{
    Frame,
    layout::{Constraint, Layout, Rect},
    style::{Color, Modifier, Style},
    text::{Line, Span},
    widgets::{Block, Paragraph, Row, Table, Wrap, canvas::Canvas},
};
use rig_model::MarkerColor;

/// Draws a snapshot; `chosen` is the index of the rig that is shown.
pub fn draw(frame: &mut Frame<'_>, snapshot: &Snapshot, chosen: usize) {
    let rig = snapshot.rigs.get(chosen.min(snapshot.rigs.len().saturating_sub(1)));
    // Two lines of border and one of headings.
    let rows = |n: usize, most: u16| u16::try_from(n).unwrap_or(most).min(most) + 3;
    let [top, topics, inputs, diagnostics] = Layout::vertical([
        Constraint::Length(13),
        Constraint::Length(rows(snapshot.topics.len(), 16)),
        Constraint::Length(rows(snapshot.inputs.len(), 8) - 1),
        Constraint::Min(4),
    ])
    .areas(frame.area());
    let [left, right] =
        Layout::horizontal([Constraint::Min(76), Constraint::Percentage(30)]).areas(top);
    draw_rig(frame, left, snapshot, rig);
    draw_image(frame, right, rig.map(|(_, rig)| rig));
    draw_topics(frame, topics, snapshot);
    let lines: Vec<Line<'_>> = snapshot
        .inputs
        .iter()
        .map(|i| {
            let bad = i.rate == 0.0 || i.dropped + i.rejected + i.lost > 0;
            Line::styled(
                input_line(i),
                if bad { Style::new().fg(Color::Yellow) } else { Style::new() },
            )
        })
        .collect();
    let hidden = lines.len().saturating_sub(rows_in(inputs));
    let title = with_hidden("inputs, as the nodes count them", hidden);
    frame.render_widget(Paragraph::new(lines).block(titled(&title)), inputs);
    let lines: Vec<Line<'_>> = snapshot
        .statuses
        .iter()
        .map(|s| {
            let color = match s.level {
                0 => Color::Green,
                1 => Color::Yellow,
                _ => Color::Red,
            };
            Line::from(vec![
                Span::styled(format!("{:5} ", level(s)), Style::new().fg(color)),
                Span::styled(
                    format!("{}: {}: ", s.hardware_id, s.name),
                    Style::new().add_modifier(Modifier::BOLD),
                ),
                Span::raw(s.message.as_str()),
            ])
        })
        .collect();
    let width = usize::from(diagnostics.width.saturating_sub(2)).max(1);
    let mut left = rows_in(diagnostics);
    let shown = lines.iter().map_while(|line| {
        left = left.checked_sub(line.width().div_ceil(width))?;
        Some(())
    });
    let hidden = lines.len() - shown.count();
    let title = with_hidden("diagnostics (q: quit, tab: next rig)", hidden);
    let text = Paragraph::new(lines).wrap(Wrap { trim: false });
    frame.render_widget(text.block(titled(&title)), diagnostics);
}

/// Rows within the border of an area.
fn rows_in(area: Rect) -> usize {
    usize::from(area.height.saturating_sub(2))
}

/// A title with the number of lines that the area does not show.
fn with_hidden(title: &str, hidden: usize) -> String {
    if hidden == 0 { title.to_owned() } else { format!("{title}: +{hidden} more") }
}

fn titled(title: &str) -> Block<'_> {
    Block::bordered().title(title)
}

fn draw_rig(
    frame: &mut Frame<'_>,
    area: Rect,
    snapshot: &Snapshot,
    rig: Option<&(String, RigState)>,
) {
    let mut lines: Vec<Line<'_>> = vec![];
    let title = match rig {
        None => "no rig: no publisher of volant/odometry, volant/visual_pose or climber/markers"
            .to_owned(),
        Some((name, _)) if name.is_empty() => "rig /".to_owned(),
        Some((name, _)) => format!("rig {name}"),
    };
    if snapshot.topics.is_empty() {
        lines.push(Line::styled(nothing(snapshot), Style::new().fg(Color::Yellow)));
    }
    if let Some((_, rig)) = rig {
        let shown = rig_lines(rig, snapshot.now);
        lines.extend(shown.into_iter().map(|(tone, head, text)| rig_line(tone, head, text)));
    }
    let text = Paragraph::new(lines).wrap(Wrap { trim: false });
    frame.render_widget(text.block(titled(&title)), area);
}

fn rig_line(tone: Tone, head: &str, text: String) -> Line<'static> {
    let head = format!("{head:8}");
    let style = match tone {
        Tone::Normal => Style::new(),
        Tone::Good => Style::new().fg(Color::Green),
        Tone::Bad => Style::new().fg(Color::Red),
        Tone::Missing => Style::new().fg(Color::Yellow),
        Tone::Marker(marker) => {
            let head = Span::styled(head, Style::new().fg(color(marker)));
            return Line::from(vec![head, Span::raw(text)]);
        }
    };
    Line::styled(head + &text, style)
}

/// Draws the markers' positions in the image. The image size is unknown here, so the frame grows
/// with the positions.
fn draw_image(frame: &mut Frame<'_>, area: Rect, rig: Option<&RigState>) {
    let seen: Vec<(MarkerColor, f64, f64)> = rig
        .iter()
        .flat_map(|r| &r.markers)
        .filter(|m| m.x.is_finite() && m.y.is_finite())
        .filter_map(|m| Some((plain::color(m)?, m.x, m.y)))
        .collect();
    let far = |least: f64, of: fn(&(MarkerColor, f64, f64)) -> f64| {
        seen.iter().map(of).fold(least, f64::max)
    };
    let (width, height) = (far(640.0, |m| m.1), far(480.0, |m| m.2));
    let canvas = Canvas::default()
        .block(titled("markers in the image"))
        .x_bounds([0.0, width])
        // Image coordinates: y points down.
        .y_bounds([-height, 0.0])
        .paint(|context| {
            for (marker, x, y) in &seen {
                context.print(*x, -*y, Span::styled("■", Style::new().fg(color(*marker))));
            }
        });
    frame.render_widget(canvas, area);
}

fn draw_topics(frame: &mut Frame<'_>, area: Rect, snapshot: &Snapshot) {
    let rows = snapshot.topics.iter().map(|topic| {
        let mut cells = vec![topic.name.clone()];
        match &topic.flow {
            Some(flow) => cells.extend(flow_cells(flow)),
            None => cells.extend([String::new(), "not subscribed (--images)".to_owned()]),
        }
        let bad = topic.publishers == 0 || topic.flow.is_some_and(|f| f.lost > 0);
        Row::new(cells).style(if bad { Style::new().fg(Color::Yellow) } else { Style::new() })
    });
    let widths = [
        Constraint::Min(30),
        Constraint::Length(11),
        Constraint::Length(27),
        Constraint::Length(17),
        Constraint::Length(9),
    ];
    let head = Row::new(["topic", "rate", "stamp to here", "", "lost"])
        .style(Style::new().add_modifier(Modifier::DIM));
    // One row is the heading.
    let hidden = (snapshot.topics.len() + 1).saturating_sub(rows_in(area));
    let title = with_hidden("topics", hidden);
    frame.render_widget(Table::new(rows, widths).header(head).block(titled(&title)), area);
}

fn color(marker: MarkerColor) -> Color {
    match marker {
        MarkerColor::Red => Color::Red,
        MarkerColor::Green => Color::Green,
        MarkerColor::Blue => Color::Blue,
        MarkerColor::Yellow => Color::Yellow,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::live::monitor::{Flow, TopicLine};
    use ratatui::{Terminal, backend::TestBackend};
    use volant_msgs::{
        diagnostic_msgs::msg::DiagnosticStatus,
        msg::{MarkerObservation, PoseStatus},
    };

    fn screen(snapshot: &Snapshot, width: u16, height: u16) -> String {
        let mut terminal = Terminal::new(TestBackend::new(width, height)).unwrap();
        terminal.draw(|frame| draw(frame, snapshot, 7)).unwrap();
        terminal.backend().to_string()
    }

    #[test]
    fn the_screen_shows_markers_rates_and_diagnostics_at_any_size() {
        let marker = MarkerObservation {
            color: MarkerObservation::GREEN,
            x: 320.0,
            y: 240.0,
            ..MarkerObservation::default()
        };
        let status = PoseStatus {
            state: PoseStatus::COASTING,
            valid: true,
            position_sigma: 0.002,
            rotation_sigma: 0.1_f64.to_radians(),
            reason: "no image for 0.5 s".to_owned(),
            ..PoseStatus::default()
        };
        let snapshot = Snapshot {
            rigs: vec![(
                "/rig1".into(),
                RigState {
                    markers: vec![marker],
                    status: Some((1, status)),
                    ..RigState::default()
                },
            )],
            topics: vec![TopicLine {
                name: "/rig1/climber/markers".into(),
                publishers: 1,
                flow: Some(Flow {
                    rate: Some(30.0),
                    delay: Some((0.01, 0.02)),
                    count: 77,
                    lost: 3,
                }),
            }],
            inputs: vec![],
            statuses: vec![DiagnosticStatus {
                level: 1,
                hardware_id: "/rig1/imu".into(),
                name: "unit".into(),
                message: "unplugged".into(),
                values: vec![],
            }],
            now: 1,
            place: String::new(),
        };
        let shown = screen(&snapshot, 120, 40);
        for needle in [
            "rig /rig1",
            "green",
            "DETECTED",
            "■",
            "30.0 Hz",
            "3 lost",
            "WARN",
            "unplugged",
            "nothing yet",
            "COASTING, valid  ±2.00 mm  ±0.10 °: no image for 0.5 s",
        ] {
            assert!(shown.contains(needle), "{needle} in\n{shown}");
        }
        // Six seconds later, with more topics than rows and a long message.
        let mut later = Snapshot { now: 6_000_000_001, ..snapshot.clone() };
        later.rigs[0].1.markers_at = 1;
        later.topics = vec![later.topics[0].clone(); 30];
        later.statuses[0].message = "unplugged ".repeat(12) + "at last";
        later.statuses = vec![later.statuses[0].clone(); 9];
        let shown = screen(&later, 120, 40);
        assert_eq!(shown.matches("(6 s ago)").count(), 2, "{shown}");
        assert!(shown.contains("topics: +14 more") && shown.contains("at last"), "{shown}");
        assert!(shown.contains("next rig): +"), "{shown}");
        for (width, height) in [(1, 1), (20, 5), (400, 100)] {
            screen(&snapshot, width, height);
            screen(&later, width, height);
            screen(&Snapshot::default(), width, height);
        }
        let empty = Snapshot { place: "DDS domain 7".to_owned(), ..Snapshot::default() };
        let shown = screen(&empty, 110, 30);
        assert!(shown.contains("no rig") && shown.contains("in DDS domain 7: check"), "{shown}");
    }
}
