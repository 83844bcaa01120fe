! Optimize: -O1
!> Tasks about spectra of signals.
module viscovib_spectrum_tasks
  use viscovib_aliased_share, only: aliased_share, is_aliased
  use viscovib_amplitude_spectrum, only: amplitude_spectrum
  use viscovib_fourier, only: check_length, real_spectrum
  use viscovib_free_decay, only: decay_type, find_free_decay
  use viscovib_kinds, only: i8, wp
  use viscovib_line_fit, only: line_residual, line_sums, lines_type, new_lines
  use viscovib_record_doubts, only: doubt_record
  use viscovib_shock_spectrum, only: find_shock_spectrum
  use viscovib_task, only: task_type
  use viscovib_windows, only: noise_bandwidth
  implicit none
  private

  public :: spectrum_task

contains

  subroutine spectrum_task(task, name)
    type(task_type), intent(inout) :: task
    character(len=*), intent(in) :: name
    select case (name)
    case ('signal')
      ! An object that contains a `signal` for several tasks.
    case ('transform')
      call transform_signal(task)
    case ('windowed')
      call find_spectra(task)
    case ('line_sums')
      call find_sums(task)
    case ('line_residual')
      call find_residual(task)
    case ('aliased')
      call find_aliased(task)
    case ('decay')
      call find_decay(task)
    case ('shock')
      call find_shock_response(task)
    case ('doubts')
      call find_doubts(task)
    case default
      call task%refuse_kind()
    end select
  end subroutine spectrum_task

  !> The discrete Fourier transform of a real `signal` (n): `spectrum` (n/2 + 1).
  subroutine transform_signal(task)
    type(task_type), intent(inout) :: task
    real(wp), pointer, contiguous :: signal(:)
    complex(wp), allocatable :: spectrum(:)

    signal => task%get_reals('signal')
    if (.not. task%failed()) call check_length(size(signal), task%status)
    if (task%failed()) return
    allocate (spectrum(size(signal)/2 + 1))
    call real_spectrum(signal, spectrum)
    call task%found%put_complexes('spectrum', spectrum, shape(spectrum))
  end subroutine transform_signal

  !> One-sided complex amplitudes of `signals` (n, m), one per column, with a `window`: `spectra`
  !! (n/2 + 1, m); `bandwidth` of the window.
  subroutine find_spectra(task)
    type(task_type), intent(inout) :: task
    real(wp), pointer, contiguous :: signals(:, :)
    complex(wp), allocatable :: spectra(:, :)
    integer :: window, j

    signals => task%get_matrix('signals')
    window = task%get_integer('window')
    if (.not. task%failed()) call check_length(size(signals, 1), task%status)
    if (task%failed()) return
    allocate (spectra(size(signals, 1)/2 + 1, size(signals, 2)))
    do j = 1, size(signals, 2)
      call amplitude_spectrum(signals(:, j), window, spectra(:, j))
    end do
    call task%found%put_complexes('spectra', spectra, shape(spectra))
    call task%found%put_real('bandwidth', noise_bandwidth(window))
  end subroutine find_spectra

  !> Sums of a least-squares fit of `lines` (4, n_lines), with columns (omega, decay, a, b), and a
  !! `mean` to a `signal` (n). Free parameters are the first `n_free` frequencies, and the decay
  !! rates of the lines in `free_decay`.
  subroutine find_sums(task)
    type(task_type), intent(inout) :: task
    real(wp), pointer, contiguous :: signal(:)
    real(wp), allocatable :: matrix(:, :), right(:)
    integer, allocatable :: free_decay(:)
    type(lines_type) :: fitted
    real(wp) :: total
    integer :: n_free, n

    call read_lines(task, signal, fitted)
    n_free = task%get_integer('n_free')
    allocate (free_decay, source=task%get_integers('free_decay'))
    if (task%failed()) return
    n = 1 + 2*size(fitted%omega) + n_free + size(free_decay)
    allocate (matrix(n, n), right(n))
    call line_sums(signal, fitted, n_free, free_decay, matrix, right, total)
    call task%found%put_reals('matrix', matrix, shape(matrix))
    call task%found%put_reals('right', right, shape(right))
    call task%found%put_real('total', total)
  end subroutine find_sums

  !> Difference between a `signal` (n) and its `lines` (4, n_lines) plus `mean`.
  subroutine find_residual(task)
    type(task_type), intent(inout) :: task
    real(wp), pointer, contiguous :: signal(:)
    real(wp), allocatable :: residual(:)
    type(lines_type) :: fitted

    call read_lines(task, signal, fitted)
    if (task%failed()) return
    allocate (residual(size(signal)))
    call line_residual(signal, fitted, residual)
    call task%found%put_reals('residual', residual, shape(residual))
  end subroutine find_residual

  subroutine read_lines(task, signal, fitted)
    type(task_type), intent(inout) :: task
    real(wp), pointer, contiguous, intent(out) :: signal(:)
    type(lines_type), intent(out) :: fitted
    real(wp), pointer, contiguous :: lines(:, :)
    real(wp) :: mean

    signal => task%get_reals('signal')
    lines => task%get_matrix('lines')
    mean = task%get_real('mean')
    call task%check_extents('lines', shape(lines), [4, size(lines, 2)])
    if (.not. task%failed()) call new_lines(fitted, lines, mean)
  end subroutine read_lines

  !> Aliased fraction of a displacement `u` (n) with velocity `v` (n), sampled with `step`;
  !! `is_large`: 1 if it deserves a warning.
  subroutine find_aliased(task)
    type(task_type), intent(inout) :: task
    real(wp), pointer, contiguous :: u(:), v(:)
    real(wp) :: step, share

    u => task%get_reals('u')
    v => task%get_reals('v')
    step = task%get_real('step')
    call task%check_extents('v', shape(v), shape(u))
    if (task%failed()) return
    share = aliased_share(u, v, step)
    call task%found%put_real('share', share)
    call task%found%put_integer('is_large', merge(1_i8, 0_i8, is_aliased(share, size(u))))
  end subroutine find_aliased

  !> Fit `count` decaying oscillations to coordinates `q` (n, n_dof) at times `t` (n): `roots`
  !! (count), `amplitudes` (count, n_dof) and the `residual`.
  subroutine find_decay(task)
    type(task_type), intent(inout) :: task
    real(wp), pointer, contiguous :: t(:), q(:, :)
    type(decay_type) :: decay
    integer :: count

    t => task%get_reals('t')
    q => task%get_matrix('q')
    call task%check_extents('q', shape(q), [size(t), size(q, 2)])
    count = task%get_integer('count')
    if (.not. task%failed()) call find_free_decay(t, q, count, decay, task%status)
    if (task%failed()) return
    call task%found%put_complexes('roots', decay%roots, shape(decay%roots))
    call task%found%put_complexes('amplitudes', decay%amplitudes, shape(decay%amplitudes))
    call task%found%put_real('residual', decay%residual)
  end subroutine find_decay

  !> Shock response spectrum of a `record` (n), with `steps` between samples (1 or n - 1), at the
  !! frequencies `hz` (m) with the ratio `damping`; `kind` and `unit` as of `find_shock_spectrum`:
  !! `extremes` (4, m).
  subroutine find_shock_response(task)
    type(task_type), intent(inout) :: task
    real(wp), pointer, contiguous :: record(:), steps(:), hz(:)
    real(wp), allocatable :: extremes(:, :)
    character(len=:), allocatable :: unit
    real(wp) :: damping
    integer :: kind

    record => task%get_reals('record')
    steps => task%get_reals('steps')
    hz => task%get_reals('hz')
    damping = task%get_real('damping')
    kind = task%get_integer('kind')
    call task%take_text('unit', unit)
    if (size(steps) /= 1) call task%check_extents('steps', shape(steps), shape(record) - 1)
    if (task%failed()) return
    call find_shock_spectrum(record, steps, hz, damping, kind, unit, extremes, task%status)
    if (task%failed()) return
    call task%found%put_reals('extremes', extremes, shape(extremes))
  end subroutine find_shock_response

  !> Doubts about `values` (n) of a record (m/s^2) called `name`, given in a `unit`, or of a formula
  !! (`is_record` false): `text`, a line each.
  subroutine find_doubts(task)
    type(task_type), intent(inout) :: task
    real(wp), pointer, contiguous :: values(:)
    character(len=:), allocatable :: name, unit, text
    logical :: is_record

    values => task%get_reals('values')
    call task%take_text('name', name)
    call task%take_text('unit', unit)
    is_record = task%get_flag('is_record')
    if (task%failed()) return
    call doubt_record(name, values, unit, is_record, text)
    call task%found%put_text('text', text)
  end subroutine find_doubts

end module viscovib_spectrum_tasks
