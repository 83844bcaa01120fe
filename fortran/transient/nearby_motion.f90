!> Evolution of small perturbations along a motion and across its switching surfaces.
!!
!! Along a step the derivatives Y of the state by an earlier one obey Y'' = A_q Y + A_v Y' with the
!! derivatives of the accelerations at the nodes of the step: collocation with the same nodes, so
!! that Y is the derivative of the step itself. At a surface h(q, v) = 0 a perturbed motion
!! switches at another time. With the right sides f- = (v, a) before and f+ after the surface and
!! the impact R, if there is one, a perturbation d becomes (M. A. Aizerman, F. R. Gantmakher, Q. J.
!! Mech. Appl. Math. 11, 1958; saltation)
!!
!!   dR d + (f+ - dR f-) (grad h . d)/(grad h . f-).
!!
!! Where the motion stays on its surface, as in sticking friction, perturbations off the surface
!! vanish: the rank falls by one, and a multiplier is exactly 0.
module viscovib_nearby_motion
  use viscovib_base_step, only: base_step
  use viscovib_dense, only: factorize, solve_columns
  use viscovib_driven_system, only: driven_system_type
  use viscovib_gauss_table, only: gauss_table_type, new_gauss_table
  use viscovib_kinds, only: wp
  use viscovib_lanes, only: n_lanes
  use viscovib_law_branches, only: slides
  use viscovib_motion_slopes, only: motion_slopes
  use viscovib_step_path, only: step_path
  implicit none
  private

  public :: nearby_motion

  !> Change of an acceleration, relative to its terms, that counts as rounding.
  real(wp), parameter :: same = 1.0e-10_wp
  !> Number of coordinates from which on steps of a repeated length share their linear part.
  integer, parameter :: many = 8

  type :: nearby_motion
    !> Derivatives of coordinates and velocities, a column each, shape (n_dof, n_columns).
    real(wp), allocatable :: q(:, :), v(:, :)
    !> True if these are known; number of surfaces crossed.
    logical :: known = .true.
    integer :: n_passed = 0
    !> Nodes, weights of v and q, sums over nodes and double sums.
    real(wp), allocatable, private :: c(:), b(:), b_q(:), a(:, :), a_q(:, :)
    !> Data shared by steps of one length, and lengths of the last steps. Parts of steps that end at
    !! a switch have lengths that do not repeat.
    type(base_step), private :: base
    real(wp), private :: lengths(4) = 0.0_wp
    !> At a surface: velocities and accelerations before; derivatives of h by coordinates and by
    !! velocities; rate of h along the motion.
    real(wp), allocatable, private :: v_before(:), a_before(:), h_q(:), h_v(:)
    !> Sizes of the terms of each acceleration at the surface.
    real(wp), allocatable, private :: terms(:)
    real(wp), private :: rate = 0.0_wp
    logical, private :: is_stop = .false., slid = .false.
  contains
    procedure :: begin
    procedure :: follow
    procedure :: arrive
    procedure :: depart
    procedure, private :: take_table
    procedure, private :: share
  end type nearby_motion

contains

  !> Start with unit perturbations of each coordinate, then of each velocity.
  subroutine begin(self, n)
    class(nearby_motion), intent(out) :: self
    integer, intent(in) :: n
    integer :: i
    allocate (self%q(n, 2*n), self%v(n, 2*n), source=0.0_wp)
    do i = 1, n
      self%q(i, i) = 1.0_wp
      self%v(i, n + i) = 1.0_wp
    end do
  end subroutine begin

  subroutine take_table(self, s)
    class(nearby_motion), intent(inout) :: self
    integer, intent(in) :: s
    type(gauss_table_type) :: table
    integer :: i, j

    if (allocated(self%b)) return
    call new_gauss_table(table, s, 0)
    allocate (self%b(s), self%b_q(s), self%a(s, s), self%a_q(s, s))
    do i = 1, s
      associate (l => mod(i - 1, n_lanes) + 1, to => (i - 1)/n_lanes + 1)
        self%b(i) = table%weights(l, to)
        self%b_q(i) = table%weights_q(l, to)
        do j = 1, s
          associate (m => mod(j - 1, n_lanes) + 1, from => (j - 1)/n_lanes + 1)
            self%a(i, j) = table%a(l, m, from, to)
            self%a_q(i, j) = table%a_q(l, m, from, to)
          end associate
        end do
      end associate
    end do
  end subroutine take_table

  !> Advance along the last part of a step; `path` has the states at the Gauss nodes.
  subroutine follow(self, system, path)
    class(nearby_motion), intent(inout) :: self
    class(driven_system_type), intent(in) :: system
    type(step_path), intent(in) :: path
    real(wp), allocatable :: by_q(:, :, :), by_v(:, :, :), g(:, :), x(:, :)
    real(wp) :: h
    integer, allocatable :: pivots(:)
    integer :: i, j, m, n, s
    logical :: singular, done

    if (.not. self%known) return
    s = size(path%points) - 2
    n = size(self%q, 1)
    m = size(self%q, 2)
    h = path%h
    call self%take_table(s)
    self%c = path%points(2:s + 1)
    call slopes_at_nodes(system, path, by_q, by_v)
    if (n >= many) then
      call self%share(h, by_q(:, :, 1), by_v(:, :, 1))
      done = .false.
      if (abs(self%base%h - h) <= 0.0_wp) then
        call self%base%advance(by_q, by_v, self%c, self%b_q, self%b, self%a_q, self%a, self%q, &
                               self%v, done)
      end if
      if (done) return
    end if
    allocate (g(s*n, s*n), x(s*n, m), pivots(s*n))
    do i = 1, s
      do j = 1, s
        g((i - 1)*n + 1:i*n, (j - 1)*n + 1:j*n) = &
          -(h**2*self%a_q(i, j)*by_q(:, :, i) + h*self%a(i, j)*by_v(:, :, i))
      end do
      x((i - 1)*n + 1:i*n, :) = matmul(by_q(:, :, i), self%q + path%points(i + 1)*h*self%v) &
                                + matmul(by_v(:, :, i), self%v)
    end do
    do i = 1, s*n
      g(i, i) = g(i, i) + 1.0_wp
    end do
    call factorize(s*n, g, pivots, singular)
    self%known = .not. singular
    if (singular) return
    call solve_columns(s*n, m, g, pivots, x)
    self%q = self%q + h*self%v
    do i = 1, s
      self%q = self%q + h**2*self%b_q(i)*x((i - 1)*n + 1:i*n, :)
      self%v = self%v + h*self%b(i)*x((i - 1)*n + 1:i*n, :)
    end do
  end subroutine follow

  !> Factorize shared data for steps of length h, if one of the last steps had this length.
  subroutine share(self, h, by_q, by_v)
    class(nearby_motion), intent(inout) :: self
    real(wp), intent(in) :: h, by_q(:, :), by_v(:, :)
    logical :: singular

    if (any(abs(self%lengths - h) <= 0.0_wp) .and. abs(self%base%h - h) > 0.0_wp) then
      call self%base%make(h, by_q, by_v, self%c, self%b_q, self%b, self%a_q, self%a, singular)
    end if
    self%lengths = [self%lengths(2:), h]
  end subroutine share

  !> Derivatives of the accelerations at the nodes, (equation, by, node).
  subroutine slopes_at_nodes(system, path, by_q, by_v)
    class(driven_system_type), intent(in) :: system
    type(step_path), intent(in) :: path
    real(wp), allocatable, intent(out) :: by_q(:, :, :), by_v(:, :, :)
    real(wp), dimension(n_lanes, system%n_dof, system%n_dof) :: some_q, some_v
    integer :: first, i, n, place(n_lanes), s

    n = system%n_dof
    s = size(path%points) - 2
    allocate (by_q(n, n, s), by_v(n, n, s))
    do first = 1, s, n_lanes
      place = [(min(first + i - 1, s) + 1, i=1, n_lanes)]
      call motion_slopes(system, path%q(place, :), path%v(place, :), &
                         system%drive_at(path%start + path%h*path%points(place)), some_q, some_v)
      do i = first, min(first + n_lanes - 1, s)
        by_q(:, :, i) = some_q(i - first + 1, :, :)
        by_v(:, :, i) = some_v(i - first + 1, :, :)
      end do
    end do
  end subroutine slopes_at_nodes

  !> Store the state at a surface, before the crossing; the motion may slide on the surface.
  subroutine arrive(self, system, which, side, t, q, v)
    class(nearby_motion), intent(inout) :: self
    class(driven_system_type), intent(in) :: system
    integer, intent(in) :: which, side
    real(wp), intent(in) :: t, q(:), v(:)

    self%n_passed = self%n_passed + 1
    self%slid = side == slides
    if (self%slid) return
    self%v_before = v
    self%a_before = acceleration_at(system, t, q, v)
    self%terms = terms_at(system, t, q, v) + abs(self%a_before)
    self%is_stop = .not. allocated(system%signals(which)%by_q)
    call find_gradient(system, which, t, q, v, self%h_q, self%h_v)
    self%rate = dot_product(self%h_q, v) + dot_product(self%h_v, self%a_before)
  end subroutine arrive

  !> Update the perturbations after the crossing.
  subroutine depart(self, system, t, q, v)
    class(nearby_motion), intent(inout) :: self
    class(driven_system_type), intent(in) :: system
    real(wp), intent(in) :: t, q(:), v(:)
    real(wp) :: early(size(self%q, 2)), jump(size(v)), change(size(v)), along
    real(wp) :: impact(size(self%q, 2))

    ! Nothing jumps where a motion stops sliding.
    if (self%slid) return
    jump = v - self%v_before
    change = acceleration_at(system, t, q, v) - self%a_before
    ! Continuous accelerations: a kink, harmless even at grazing. Each coordinate has its own unit.
    self%terms = self%terms + terms_at(system, t, q, v)
    if (.not. self%is_stop .and. all(abs(change) <= same*self%terms)) return
    self%known = self%known .and. abs(self%rate) > tiny(1.0_wp)
    if (.not. self%known) return
    early = (matmul(self%h_q, self%q) + matmul(self%h_v, self%v))/self%rate
    if (self%is_stop) then
      ! An impact changes the velocity towards the stop.
      along = dot_product(self%h_q, self%v_before)
      impact = matmul(self%h_q, self%v)/along
      change = change - jump*(dot_product(self%h_q, self%a_before)/along)
      self%v = self%v + outer(jump, impact)
    end if
    self%q = self%q + outer(jump, early)
    self%v = self%v + outer(change, early)
  end subroutine depart

  pure function outer(x, y) result(product)
    real(wp), intent(in) :: x(:), y(:)
    real(wp) :: product(size(x), size(y))
    product = spread(x, 2, size(y))*spread(y, 1, size(x))
  end function outer

  function acceleration_at(system, t, q, v) result(a)
    class(driven_system_type), intent(in) :: system
    real(wp), intent(in) :: t, q(:), v(:)
    real(wp) :: a(size(q)), lanes(n_lanes, size(q))
    call system%acceleration(spread(q, 1, n_lanes), spread(v, 1, n_lanes), &
                             system%drive_at(spread(t, 1, n_lanes)), lanes)
    a = lanes(1, :)
  end function acceleration_at

  !> Magnitude of the state-dependent terms of each acceleration.
  function terms_at(system, t, q, v) result(terms)
    class(driven_system_type), intent(in) :: system
    real(wp), intent(in) :: t, q(:), v(:)
    real(wp) :: terms(size(q))
    real(wp), dimension(n_lanes, size(q), size(q)) :: by_q, by_v
    call motion_slopes(system, spread(q, 1, n_lanes), spread(v, 1, n_lanes), &
                       system%drive_at(spread(t, 1, n_lanes)), by_q, by_v)
    terms = matmul(abs(by_q(1, :, :)), abs(q)) + matmul(abs(by_v(1, :, :)), abs(v))
  end function terms_at

  !> Derivatives of a surface's signal: by the program of a law, or by differences for a stop, whose
  !! signal is linear in coordinates.
  subroutine find_gradient(system, which, t, q, v, h_q, h_v)
    class(driven_system_type), intent(in) :: system
    integer, intent(in) :: which
    real(wp), intent(in) :: t, q(:), v(:)
    real(wp), allocatable, intent(inout) :: h_q(:), h_v(:)
    real(wp) :: value(1), g(2), places(2, size(q)), unit
    real(wp), allocatable :: slopes(:, :)
    integer :: d

    associate (signal => system%signals(which))
      if (allocated(signal%by_q)) then
        allocate (slopes(1, size(signal%by_q, 1)))
        call signal%program%differentiate(reshape(matmul(signal%by_q, q) &
                                                  + matmul(signal%by_v, v), shape(slopes)), &
                                          value, slopes)
        h_q = matmul(slopes(1, :), signal%by_q)
        h_v = matmul(slopes(1, :), signal%by_v)
        return
      end if
    end associate
    h_q = q
    h_v = 0.0_wp*v
    unit = max(maxval(abs(q)), tiny(1.0_wp))
    do d = 1, size(q)
      places = spread(q, 1, 2)
      places(:, d) = q(d) + [-unit, unit]
      call system%signal_at(which, [t, t], places, spread(v, 1, 2), g)
      h_q(d) = (g(2) - g(1))/(2.0_wp*unit)
    end do
  end subroutine find_gradient

end module viscovib_nearby_motion
