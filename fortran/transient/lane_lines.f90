!> Amplitudes at given frequencies, accumulated along trajectories without storing them:
!! one accumulator per lane.
module viscovib_lane_lines
  use viscovib_constants, only: pi
  use viscovib_kinds, only: i8, wp
  use viscovib_lanes, only: max_dof, n_lanes
  use viscovib_phases, only: split_phase, step_phase
  use viscovib_vector_math, only: sine_cosine_lanes
  implicit none
  private

  public :: lines_type, new_lines

  !> Amplitudes at given frequencies: u = mean + Re(X exp(i omega t)), by
  !! projection under a Hann window over the whole record.
  type :: lines_type
    integer :: n_dof = 0, n = 0
    integer(i8) :: n_samples = 0, i = 0
    real(wp), allocatable, private :: high(:, :), low(:, :), step_high(:, :), step_low(:, :)
    !> Lane; lane and line; lane and coordinate; lane, line and coordinate.
    real(wp), private :: weight(n_lanes) = 0.0_wp, mean(n_lanes, max_dof) = 0.0_wp
    complex(wp), allocatable, private :: empty(:, :), sums(:, :, :)
  contains
    procedure :: add => add_lines
    procedure :: amplitudes
  end type lines_type

contains

  !> Lines at circular frequencies omega from samples at start + i step, i = 0
  !! ... n_samples - 1; step differs from lane to lane.
  pure subroutine new_lines(lines, n_dof, omega, start, step, n_samples)
    type(lines_type), intent(out) :: lines
    integer, intent(in) :: n_dof
    real(wp), intent(in) :: omega(:), start(n_lanes), step(n_lanes)
    integer(i8), intent(in) :: n_samples
    integer :: n

    n = size(omega)
    lines%n_dof = n_dof
    lines%n = n
    lines%n_samples = n_samples
    allocate (lines%high(n_lanes, n), lines%low(n_lanes, n))
    allocate (lines%step_high(n_lanes, n), lines%step_low(n_lanes, n))
    call split_phase(spread(omega, 1, n_lanes), spread(start, 2, n), lines%high, lines%low)
    call split_phase(spread(omega, 1, n_lanes), spread(step, 2, n), lines%step_high, &
                     lines%step_low)
    allocate (lines%empty(n_lanes, n), lines%sums(n_lanes, n, n_dof), source=(0.0_wp, 0.0_wp))
  end subroutine new_lines

  pure subroutine add_lines(self, q, alive)
    class(lines_type), intent(inout) :: self
    real(wp), intent(in) :: q(n_lanes, *)
    logical, intent(in) :: alive(n_lanes)
    real(wp) :: window(n_lanes), s(n_lanes), c(n_lanes)
    complex(wp) :: turned(n_lanes)
    integer :: j, d

    ! The window vanishes one sample before the first and one after the last.
    window = merge(sin(pi*real(self%i + 1, wp)/real(self%n_samples + 1, wp))**2, 0.0_wp, alive)
    self%i = self%i + 1
    self%weight = self%weight + window
    do d = 1, self%n_dof
      self%mean(:, d) = self%mean(:, d) + window*q(:, d)
    end do
    do j = 1, self%n
      call sine_cosine_lanes(self%high(:, j), s, c)
      turned = window*cmplx(c - s*self%low(:, j), -(s + c*self%low(:, j)), wp)
      self%empty(:, j) = self%empty(:, j) + turned
      do d = 1, self%n_dof
        self%sums(:, j, d) = self%sums(:, j, d) + q(:, d)*turned
      end do
    end do
    call step_phase(self%high, self%low, self%step_high, self%step_low)
  end subroutine add_lines

  !> X, shape (n_lanes, n, n_dof), without the leakage of the mean.
  pure function amplitudes(self) result(x)
    class(lines_type), intent(in) :: self
    complex(wp) :: x(n_lanes, self%n, self%n_dof)
    integer :: l, d
    do d = 1, self%n_dof
      do l = 1, n_lanes
        if (self%weight(l) > 0.0_wp) then
          x(l, :, d) = 2.0_wp*(self%sums(l, :, d) &
                               - self%mean(l, d)/self%weight(l)*self%empty(l, :))/self%weight(l)
        else
          x(l, :, d) = (0.0_wp, 0.0_wp)
        end if
      end do
    end do
  end function amplitudes

end module viscovib_lane_lines
