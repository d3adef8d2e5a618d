//! Warnings for the operator: rejected readings, encoders that were re-zeroed, clocks set back.

use thiserror::Error;

/// Warning for the operator.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum Warning {
    /// A reading was rejected; the last accepted one remains valid.
    #[error("joint_states: {text}")]
    Rejected {
        /// Short name under which rejections are counted.
        kind: &'static str,
        /// Reason and remedy.
        text: String,
    },
    /// Readings after a jump were consistent with each other and are accepted again.
    #[error(
        "position changed by {:+.3} m, {:+.3} m, {:+.4} rad and accepted after {rejected} \
         consistent readings; check the encoders unless they were re-zeroed",
        change[0], change[1], change[2]
    )]
    Relocated {
        /// Change since the last reading before the jump: m, m, rad.
        change: [f64; 3],
        /// Number of readings that had been rejected.
        rejected: u32,
    },
    /// The receiver's clock went back (a replay was restarted); the state was reset.
    #[error("time went back by {seconds:.3} s: state reset")]
    TimeWentBack {
        /// Step of the clock, s.
        seconds: f64,
    },
}

impl Warning {
    /// Short name of its kind.
    pub const fn kind(&self) -> &'static str {
        match self {
            Self::Rejected { kind, .. } => kind,
            Self::Relocated { .. } => "relocated",
            Self::TimeWentBack { .. } => "time went back",
        }
    }
}
