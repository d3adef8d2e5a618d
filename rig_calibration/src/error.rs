use thiserror::Error;

/// Why a recording does not calibrate a rig.
#[derive(Clone, Copy, Debug, Error, PartialEq, Eq)]
pub enum CalibrationError {
    /// Too few messages: their number, and the topic.
    #[error("{0} messages of {1}; record it too, for ten seconds at least")]
    TooShort(usize, &'static str),
    /// Too few images show all markers: this number.
    #[error(
        "only {0} images show all four markers; record the fully visible platform for ten seconds \
         at least"
    )]
    FewImages(usize),
    /// No pose fits the first image.
    #[error("no pose fits the first image; check the markers in the rig file")]
    NoPose,
    /// Most poses lie behind the camera.
    #[error("most poses lie behind the camera; check the camera's mounting in the rig file")]
    Behind,
    /// The adjustment diverges.
    #[error(
        "the adjustment does not converge; check the rig file (axes, signs) and the stamps of \
         the recording"
    )]
    Diverged,
    /// The motion determines no mounting.
    #[error(
        "the motion determines neither the camera's nor the IMU's mounting; swing the platform \
         about both horizontal axes, turn it, and drive and turn the climber while recording"
    )]
    Undetermined,
}
