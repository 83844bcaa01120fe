!> Results of many motions, and their change with a smaller step size.
module viscovib_many_motions
  use, intrinsic :: ieee_arithmetic, only: ieee_quiet_nan, ieee_value
  use viscovib_ensemble, only: ensemble_block, ensemble_job
  use viscovib_event_errors, only: located
  use viscovib_gathered, only: gathered_type
  use viscovib_kinds, only: wp
  use viscovib_time_run, only: run_coarse, run_completed, run_diverged
  implicit none
  private

  public :: compare

  !> Smallest unit of comparison of a coordinate, relative to the largest coordinate.
  real(wp), parameter :: smallest = 1.0e-6_wp

  !> Results; the run is the last index. Peaks and means that are not requested have no columns.
  type, public :: many_motions
    real(wp), allocatable, dimension(:, :) :: state, peak, mean, rms, lyapunov, lyapunov_error
    real(wp), allocatable :: t_reached(:), sections(:, :, :)
    complex(wp), allocatable :: amplitudes(:, :, :)
    integer, allocatable :: ended(:)
    !> True if common steps may have missed a thin layer of a force.
    logical, allocatable :: missed(:)
    !> Motion with the largest difference from a run with twice the step size.
    integer :: worst = 1
  contains
    procedure :: begin
    procedure :: take_lane
    procedure :: take_single
  end type many_motions

contains

  !> Prepare for n motions with states of w numbers, and sections of some points.
  subroutine begin(self, job, w, n, points)
    class(many_motions), intent(out) :: self
    type(ensemble_job), intent(in) :: job
    integer, intent(in) :: w, n, points

    allocate (self%state(w, n), self%t_reached(n), source=0.0_wp)
    allocate (self%ended(n), source=run_completed)
    allocate (self%missed(n), source=.false.)
    allocate (self%peak(w, merge(n, 0, job%moments)), source=0.0_wp)
    allocate (self%mean, self%rms, source=self%peak)
    allocate (self%lyapunov(job%n_exponents, n), source=0.0_wp)
    allocate (self%lyapunov_error, source=self%lyapunov)
    allocate (self%amplitudes(w/2, size(job%lines), n), source=(0.0_wp, 0.0_wp))
    allocate (self%sections(w, points, n))
    self%sections = ieee_value(0.0_wp, ieee_quiet_nan)
  end subroutine begin

  !> Copy the results of a lane to motion i.
  subroutine take_lane(self, block, l, i)
    class(many_motions), intent(inout) :: self
    type(ensemble_block), intent(in) :: block
    integer, intent(in) :: l, i

    self%state(1::2, i) = block%q(l, :)
    self%state(2::2, i) = block%v(l, :)
    self%ended(i) = block%outcome(l)
    self%t_reached(i) = block%t_reached(l)
    self%missed(i) = block%missed(l)
    self%sections(:, :, i) = block%sections(l, :, :)
    self%lyapunov(:, i) = block%lyapunov(l, :size(self%lyapunov, 1))
    self%lyapunov_error(:, i) = block%lyapunov_error(l, :size(self%lyapunov, 1))
    if (size(self%amplitudes, 2) > 0) self%amplitudes(:, :, i) = transpose(block%lines(l, :, :))
    if (size(self%peak) > 0) then
      call put_moments(block%peak(l, :, :), self%peak(:, i))
      call put_moments(block%mean(l, :, :), self%mean(:, i))
      call put_moments(block%rms(l, :, :), self%rms(:, i))
    end if
    call blank_early(self, i)
  end subroutine take_lane

  !> Set what was gathered along motion i to NaN if it ended early.
  subroutine blank_early(self, i)
    class(many_motions), intent(inout) :: self
    integer, intent(in) :: i
    real(wp) :: unset

    if (self%ended(i) == run_completed) return
    unset = ieee_value(unset, ieee_quiet_nan)
    self%amplitudes(:, :, i) = cmplx(unset, unset, wp)
    if (size(self%peak) == 0) return
    self%peak(:, i) = unset
    self%mean(:, i) = unset
    self%rms(:, i) = unset
  end subroutine blank_early

  !> Interleave the values of displacements and velocities.
  pure subroutine put_moments(of_block, of_run)
    real(wp), intent(in) :: of_block(:, :)
    real(wp), intent(out) :: of_run(:)
    of_run(1::2) = of_block(:, 1)
    of_run(2::2) = of_block(:, 2)
  end subroutine put_moments

  !> Copy what was gathered along motion i to some rows of states.
  subroutine take_single(self, found, rows, i)
    class(many_motions), intent(inout) :: self
    type(gathered_type), intent(in) :: found
    integer, intent(in) :: rows(:), i

    self%state(rows, i) = found%state
    self%ended(i) = found%ended
    self%t_reached(i) = found%t_reached
    if (size(self%sections) > 0) self%sections(rows, :, i) = found%sections
    if (size(self%amplitudes) > 0) self%amplitudes(:, :, i) = found%amplitudes
    self%lyapunov(:, i) = found%lyapunov
    self%lyapunov_error(:, i) = found%lyapunov_error
    if (size(self%peak) > 0) then
      self%peak(rows, i) = found%peak
      self%mean(rows, i) = found%mean
      self%rms(rows, i) = found%rms
    end if
    call blank_early(self, i)
  end subroutine take_single

  !> Test if motions with half the step size agree, and compute their difference; if they agree, the
  !! difference includes the rounding error.
  subroutine compare(coarse, fine, absolute, relative, change, met)
    type(many_motions), intent(in) :: coarse
    !> Exponents get an error of at least their difference between the two runs.
    type(many_motions), intent(inout) :: fine
    real(wp), intent(in) :: absolute, relative
    real(wp), intent(out) :: change
    logical, intent(out) :: met
    real(wp), dimension(size(fine%state, 1), size(fine%state, 2)) :: along, parts
    real(wp), dimension(size(fine%state, 1)) :: sizes, tops
    real(wp), dimension(size(fine%ended)) :: late, moved, changes
    real(wp), dimension(size(fine%lyapunov, 1)) :: off
    real(wp) :: rounded
    logical :: alive(size(fine%ended))
    integer :: d, i

    alive = coarse%ended == run_completed .and. fine%ended == run_completed
    parts = abs(fine%state - coarse%state)
    ! For a diverged state only the time is compared.
    where (spread(fine%ended == run_diverged, 1, size(parts, 1))) parts = 0.0_wp
    moved = abs(fine%t_reached - coarse%t_reached)
    along = 0.0_wp
    tops = 0.0_wp
    rounded = 0.0_wp
    do i = 1, size(alive)
      ! Peaks and means of a motion that stopped are NaN.
      if (.not. alive(i)) cycle
      off = abs(fine%lyapunov(:, i) - coarse%lyapunov(:, i))
      where (off > fine%lyapunov_error(:, i)) fine%lyapunov_error(:, i) = off
      rounded = max(rounded, maxval(abs(fine%state(:, i))))
      if (size(fine%peak) == 0) cycle
      along(:, i) = max(abs(fine%peak(:, i) - coarse%peak(:, i)), &
                        abs(fine%mean(:, i) - coarse%mean(:, i)), &
                        abs(fine%rms(:, i) - coarse%rms(:, i)))
      tops = max(tops, fine%peak(:, i))
      rounded = max(rounded, maxval(fine%peak(:, i)))
    end do
    changes = max(maxval(parts, 1), maxval(along, 1), moved)
    where (coarse%ended /= fine%ended .or. fine%ended == run_coarse) changes = huge(1.0_wp)
    fine%worst = maxloc(changes, 1)
    change = changes(fine%worst)
    met = .false.
    if (.not. change < huge(1.0_wp)) return
    do d = 1, size(sizes)
      sizes(d) = maxval([0.0_wp, pack(abs(fine%state(d, :)), alive)])
    end do
    sizes = absolute + relative*max(sizes, smallest*maxval(sizes))
    tops = absolute + relative*max(tops, smallest*maxval(tops))
    late = absolute + relative*fine%t_reached
    met = all(moved <= late) .and. all(alive .or. maxval(parts, 1) <= late)
    do d = 1, size(sizes)
      met = met .and. all(.not. alive .or. (parts(d, :) <= sizes(d) .and. along(d, :) <= tops(d)))
    end do
    if (.not. met) return
    change = max(change, 4.0_wp*epsilon(1.0_wp)*rounded)
    if (.not. all(alive)) change = max(change, located*max(1.0_wp, maxval(fine%t_reached, &
                                                                          mask=.not. alive)))
  end subroutine compare

end module viscovib_many_motions
