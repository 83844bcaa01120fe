! Optimize: -O3
!> Pieces of a period with sixteen Gauss points each, and integrals over them.
!!
!! A function that is smooth inside a piece is integrated to its own accuracy, even with kinks at
!! the ends; equidistant samples would alias all of its high harmonics.
module viscovib_phase_panels
  use viscovib_constants, only: pi
  use viscovib_gauss_points, only: points_16, weights_16
  use viscovib_harmonic_set, only: harmonic_set_type
  use viscovib_kinds, only: wp
  use viscovib_phase_roots, only: phase_list
  implicit none
  private

  public :: add_moments, add_parts, is_resolved, longest_panel, motion_at, new_panel, panel_type, &
            panel_walk, wave_sum, waves_at, weigh

  integer, parameter, public :: nodes = 16
  !> Largest length of a piece times the highest order: for products of two such harmonics sixteen
  !! points have an error of 1e-13.
  real(wp), parameter :: phase_at_most = 10.0_wp
  !> Largest relative size of the last two Legendre coefficients of a function that the points
  !! resolve.
  real(wp), parameter :: resolved = 1.0e-11_wp

  !> Coefficients of a function by the Legendre polynomials 14 and 15, from its values:
  !! (2 k + 1) w_i P_k(x_i).
  real(wp), parameter :: last_two(nodes, 2) = reshape([ &
    0.06270545045312346224_wp, -0.2049354038701399205_wp, 0.3541214949557947067_wp, &
    -0.4628447876645263636_wp, 0.4977022367517182479_wp, -0.4435406121078920673_wp, &
    0.3058334374396040079_wp, -0.1090418159576820733_wp, -0.1090418159576820733_wp, &
    0.3058334374396040079_wp, -0.4435406121078920673_wp, 0.4977022367517182479_wp, &
    -0.4628447876645263636_wp, 0.3541214949557947067_wp, -0.2049354038701399205_wp, &
    0.06270545045312346224_wp, &
    -0.03278130486396173942_wp, 0.1122209124505884013_wp, -0.2115985306318844377_wp, &
    0.3169196177972208307_wp, -0.4166403770259613652_wp, 0.5008933497159644381_wp, &
    -0.56174614482927911_wp, 0.5936159289428018117_wp, -0.5936159289428018117_wp, &
    0.56174614482927911_wp, -0.5008933497159644381_wp, 0.4166403770259613652_wp, &
    -0.3169196177972208307_wp, 0.2115985306318844377_wp, -0.1122209124505884013_wp, &
    0.03278130486396173942_wp], [nodes, 2])

  type :: panel_type
    real(wp) :: theta(nodes), weight(nodes)
    !> Cosines and sines of the included orders, shape (nodes, n_orders).
    real(wp), allocatable :: c(:, :), s(:, :)
  end type panel_type

  !> The pieces of a stretch from each of some phases to the next. Each piece is halved until it is
  !! accepted.
  type :: panel_walk
    !> End of the last piece, and of the stretch; longest piece, and the shortest in units of it.
    real(wp) :: from = 0.0_wp, ending = 0.0_wp, longest = 0.0_wp, shortest = 1.0e-5_wp
    type(phase_list) :: ends
    !> Number of pieces after which all are accepted, since points do not resolve rounding errors.
    integer :: tries = 400
    !> True if the last piece was accepted.
    logical :: accepted = .true.
    real(wp), private :: to = 0.0_wp, length = 0.0_wp
    integer, private :: i = 0
  contains
    procedure :: next
    procedure :: is_last_try
  end type panel_walk

contains

  !> Make the next piece; false: there is none.
  logical function next(self, set, panel)
    class(panel_walk), intent(inout) :: self
    type(harmonic_set_type), intent(in) :: set
    type(panel_type), intent(inout) :: panel

    if (self%i == 0) self%to = self%from
    if (.not. self%accepted) then
      self%length = 0.5_wp*self%length
    else if (self%i > 0) then
      self%from = self%from + self%length
      call divide(min(self%longest, 2.0_wp*self%length))
    end if
    do while (.not. self%to - self%from > 4.0_wp*epsilon(1.0_wp)*self%ending)
      next = self%i <= self%ends%n
      if (.not. next) return
      self%i = self%i + 1
      self%from = self%to
      self%to = self%ending
      if (self%i <= self%ends%n) self%to = min(self%ends%theta(self%i), self%ending)
      call divide(self%longest)
    end do
    next = .true.
    self%length = min(self%length, self%to - self%from)
    call new_panel(panel, set, self%from, self%from + self%length)
    self%tries = self%tries - 1

  contains

    !> Pieces of equal length up to the next phase.
    subroutine divide(most)
      real(wp), intent(in) :: most
      self%length = (self%to - self%from)/max(1, ceiling((self%to - self%from)/most))
    end subroutine divide

  end function next

  !> True if the present piece must be accepted.
  pure logical function is_last_try(self)
    class(panel_walk), intent(in) :: self
    is_last_try = self%tries < 0 .or. self%length <= self%shortest*self%longest
  end function is_last_try

  pure real(wp) function longest_panel(set)
    type(harmonic_set_type), intent(in) :: set
    longest_panel = phase_at_most/max(1, maxval(set%orders))
  end function longest_panel

  !> The piece from one phase to another.
  subroutine new_panel(panel, set, from, to)
    type(panel_type), intent(inout) :: panel
    type(harmonic_set_type), intent(in) :: set
    real(wp), intent(in) :: from, to
    real(wp) :: c1(nodes), s1(nodes)
    integer :: i, n, first

    n = size(set%orders)
    if (.not. allocated(panel%c)) allocate (panel%c(nodes, n), panel%s(nodes, n))
    panel%theta = from + (to - from)*points_16
    panel%weight = (to - from)*weights_16
    first = merge(1, 0, set%half_wave)
    c1 = cos(panel%theta)
    s1 = sin(panel%theta)
    if (first == 0) then
      panel%c(:, 1) = 1.0_wp
      panel%s(:, 1) = 0.0_wp
    else
      panel%c(:, 1) = c1
      panel%s(:, 1) = s1
      s1 = 2.0_wp*s1*c1
      c1 = 2.0_wp*c1*c1 - 1.0_wp
    end if
    do i = 2, n
      panel%c(:, i) = panel%c(:, i - 1)*c1 - panel%s(:, i - 1)*s1
      panel%s(:, i) = panel%s(:, i - 1)*c1 + panel%c(:, i - 1)*s1
    end do
  end subroutine new_panel

  !> A motion at the points.
  pure function motion_at(panel, y) result(d)
    type(panel_type), intent(in) :: panel
    !> Alternating real and imaginary parts.
    real(wp), intent(in) :: y(:)
    real(wp) :: d(nodes)
    integer :: i
    d = 0.0_wp
    do i = 1, size(panel%c, 2)
      d = d + y(2*i - 1)*panel%s(:, i) + y(2*i)*panel%c(:, i)
    end do
  end function motion_at

  !> True if sixteen points resolve a function: its last two Legendre coefficients are small.
  pure logical function is_resolved(f, size_of)
    real(wp), intent(in) :: f(nodes), size_of
    is_resolved = maxval(abs(matmul(f, last_two))) <= resolved*max(size_of, maxval(abs(f)))
  end function is_resolved

  !> Add the contribution of a function to each harmonic, before `weigh`.
  pure subroutine add_parts(panel, f, parts)
    type(panel_type), intent(in) :: panel
    real(wp), intent(in) :: f(nodes)
    real(wp), intent(inout) :: parts(:)
    real(wp) :: weighted(nodes)
    integer :: i
    weighted = panel%weight*f
    do i = 1, size(panel%c, 2)
      parts(2*i - 1) = parts(2*i - 1) + sum(weighted*panel%s(:, i))
      parts(2*i) = parts(2*i) + sum(weighted*panel%c(:, i))
    end do
  end subroutine add_parts

  !> Scale integrals over the period, or half of it, to harmonics.
  pure subroutine weigh(set, parts)
    type(harmonic_set_type), intent(in) :: set
    real(wp), intent(inout) :: parts(:)
    parts = parts*merge(2.0_wp, 1.0_wp, set%half_wave)/pi
    if (set%orders(1) == 0) parts(:2) = 0.5_wp*parts(:2)
  end subroutine weigh

  !> Add to the mean values of a function times cos and sin of m strides, m = 0, 1, ..., reach.
  pure subroutine add_moments(panel, set, f, c, s)
    type(panel_type), intent(in) :: panel
    type(harmonic_set_type), intent(in) :: set
    real(wp), intent(in) :: f(nodes)
    real(wp), intent(inout) :: c(0:), s(0:)
    real(wp) :: weighted(nodes), c1(nodes), s1(nodes), cm(nodes), sm(nodes), turned(nodes)
    integer :: m

    weighted = panel%weight*f*merge(1.0_wp, 0.5_wp, set%half_wave)/pi
    if (set%half_wave) then
      s1 = 2.0_wp*panel%s(:, 1)*panel%c(:, 1)
      c1 = 2.0_wp*panel%c(:, 1)**2 - 1.0_wp
    else
      s1 = panel%s(:, 2)
      c1 = panel%c(:, 2)
    end if
    cm = weighted
    sm = 0.0_wp
    do m = 0, ubound(c, 1)
      c(m) = c(m) + sum(cm)
      s(m) = s(m) + sum(sm)
      turned = cm*c1 - sm*s1
      sm = sm*c1 + cm*s1
      cm = turned
    end do
  end subroutine add_moments

  !> sin and cos of the orders at one phase, alternating.
  pure function waves_at(set, theta) result(waves)
    type(harmonic_set_type), intent(in) :: set
    real(wp), intent(in) :: theta
    real(wp) :: waves(2*size(set%orders))
    waves(1::2) = sin(set%orders*theta)
    waves(2::2) = cos(set%orders*theta)
  end function waves_at

  !> A motion at one phase.
  pure real(wp) function wave_sum(set, y, theta)
    type(harmonic_set_type), intent(in) :: set
    real(wp), intent(in) :: y(:), theta
    real(wp) :: c, s, c1, s1, turned
    integer :: i

    c1 = cos(theta)
    s1 = sin(theta)
    if (set%half_wave) then
      c = c1
      s = s1
      s1 = 2.0_wp*s*c
      c1 = 2.0_wp*c*c - 1.0_wp
    else
      c = 1.0_wp
      s = 0.0_wp
    end if
    wave_sum = 0.0_wp
    do i = 1, size(set%orders)
      wave_sum = wave_sum + y(2*i - 1)*s + y(2*i)*c
      turned = c*c1 - s*s1
      s = s*c1 + c*s1
      c = turned
    end do
  end function wave_sum

end module viscovib_phase_panels
