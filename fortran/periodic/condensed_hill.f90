! Optimize: -O2 -fvect-cost-model=dynamic
!> Hill's determinant of a condensed structure: as large as its elements, not as its linear rest.
!!
!! A small disturbance of the deflections of the elements (`viscovib_hill_determinant`) obeys, with
!! the compliance H(s) of the linear rest and the local stiffness of the elements along the motion,
!!
!!   Delta(lambda) = det(I + diag[H(s_k)] J) = 0,
!!   J_kl = sum_j b_j [f_j(s_k) (w_j,(k-l) + W_j delta_kl) - W_j delta_kl],
!!
!! w_j the Fourier coefficients of the slopes of variable j (with s_l times those by rates), W_j
!! its linear part where it remembers (the rest has that part without memory), f_j = 1 -
!! epsilon_1 R_j (equation (2) of the theory of structures, docs/explanation). Delta has poles at
!! the poles p of the rest modulo i d. Those are multiplied out that could hide a zero next to them,
!!
!!   F(lambda) = Delta(lambda) prod_p [1 - exp(2 pi (p - lambda)/d)],
!!
!! where |b| |J| |c|/|2 p + rate|, by how much elements move a pole, is no small part of its
!! distance from the axis.
module viscovib_condensed_hill
  use viscovib_band_elimination, only: band_determinant
  use viscovib_compliance_band, only: compliance_band, new_band
  use viscovib_condensed_poles, only: condensed_poles, new_poles
  use viscovib_condensed_rows, only: fill_one, find_swings, measure_waves, strength, waves_of_rates
  use viscovib_condensed_waves, only: fill_waves, soften
  use viscovib_constants, only: pi
  use viscovib_dense, only: invert
  use viscovib_harmonic_set, only: harmonic_set_type
  use viscovib_hill_blocks, only: moments_of
  use viscovib_hill_determinant, only: hill_determinant, retained_of, slow
  use viscovib_kinds, only: wp
  use viscovib_lanes, only: n_lanes
  use viscovib_oscillator, only: oscillator_type
  use viscovib_structure, only: structure_type
  implicit none
  private

  public :: average, condensed_hill, moved_by_waves, new_condensed_hill

  !> Multipliers this close to the unit circle count as on it.
  real(wp), parameter, public :: circle = 1.0e-9_wp
  !> Unknowns of a determinant at most.
  integer, parameter :: max_unknowns = 600
  !> Orders are kept until H J is this small beyond them, and what reaches them, which is squared
  !! before it acts on exponents, that small; fair where this takes more than a few unknowns.
  real(wp), parameter :: negligible = 0.2_wp, accurate = 1.0e-5_wp, fair = 3.0e-4_wp
  integer, parameter :: few_unknowns = 120, many_unknowns = 240
  !> Parts of J that are small compared with the largest are left out.
  real(wp), parameter :: silent = 1.0e-9_wp
  !> Modes are nearly rigid bodies whose poles are nearer to 0, in d.
  real(wp), parameter :: nearly_rigid = 1.0e-3_wp
  !> Fourier coefficients of J that are small compared with the largest hardly move exponents.
  real(wp), parameter :: faint = 1.0e-3_wp

  type, extends(hill_determinant) :: condensed_hill
    !> Poles of the rest.
    type(condensed_poles) :: poles
    !> Exponents right of the line Re lambda = line grow (1/s).
    real(wp) :: line = 0.0_wp
    !> Poles nearer to 0 are those of rigid bodies (rad/s).
    real(wp), private :: nearness = 0.0_wp
    type(compliance_band), private :: band
    !> J of each group, by the difference of orders, shape (n_dof, n_dof, -reach:reach, groups),
    !! and what it is less of hereditary ones, (n_dof, n_dof).
    complex(wp), allocatable, private :: local(:, :, :, :)
    real(wp), allocatable, private :: without(:, :)
    !> Deflections between which J is not constant, and the others.
    integer, allocatable, private :: swings(:), others(:)
    !> Norms of J_m, m = 1, ..., and how large a part it is of the largest J, whatever the units.
    real(wp), allocatable :: sizes(:), parts(:)
    real(wp), allocatable, private :: re(:, :), im(:, :)
    !> As `local` what depends on rates, not allocated if nothing does.
    complex(wp), allocatable :: by_rate(:, :, :, :)
  contains
    procedure :: along
    procedure :: vary
    procedure :: compliances
    procedure :: count_from
    procedure :: of_orders
    procedure :: without_poles
    procedure :: mean_system
    procedure :: relaxation
    procedure :: on_line
    procedure :: local_at
    procedure, private :: find_motion
    procedure, private :: find_local
    procedure, private :: find_orders
    procedure, private :: fill_swings
  end type condensed_hill

contains

  !> For motions with the harmonics of `set`.
  subroutine new_condensed_hill(hill, system, set)
    type(condensed_hill), intent(out) :: hill
    class(structure_type), intent(in) :: system
    type(harmonic_set_type), intent(in) :: set
    call hill%prepare(system, set, max(2*system%degree - 3, 3))
    hill%without = matmul(system%spread, system%gather &
                          *spread(merge(1.0_wp, 0.0_wp, system%kernel_of > 0), 2, hill%n_dof))
    call new_poles(hill%poles, system%rest)
  end subroutine new_condensed_hill

  !> Everything that the motion x at frequency nu (rad/s) decides.
  subroutine along(self, system, nu, x, all_poles)
    class(condensed_hill), intent(inout) :: self
    class(structure_type), intent(in) :: system
    real(wp), intent(in) :: nu
    !> Harmonics, real and imaginary part by turns, shape (2 n_orders, n_dof).
    real(wp), intent(in) :: x(:, :)
    !> Multiply out all poles that elements move. The determinant is not ready until `count_from`.
    logical, intent(in) :: all_poles
    real(wp), dimension(self%n_dof, self%n_dof) :: largest, strongest
    call self%set_period(system, nu)
    ! Loss factors have no meaning off the axis.
    self%ready = system%separable .and. .not. any(abs(system%rest%losses) > 0.0_wp)
    if (.not. self%ready) return
    call self%find_motion(system, x, largest, strongest)
    if (.not. self%ready) return
    self%line = circle*self%period/(2.0_wp*pi)
    ! Without integral of a kernel motions may creep away slowly.
    if (self%creeps) self%line = slow*self%period
    ! The same for neighbours.
    if (.not. abs(self%nearness/(nearly_rigid*self%period) - 1.0_wp) < 0.3_wp) then
      self%nearness = nearly_rigid*self%period
    end if
    call self%poles%weigh(largest, strongest, self%period, self%stride, self%nearness, self%line, &
                          self%ready, all_poles)
    self%n_without_memory = self%poles%n_multiplied
    self%n_apart = self%poles%n_growing
    if (self%ready .and. .not. all_poles) call self%find_orders(system)
  end subroutine along

  !> A motion very near that of `along`: its J, with the same poles and orders.
  subroutine vary(self, system, x)
    class(condensed_hill), intent(inout) :: self
    class(structure_type), intent(in) :: system
    real(wp), intent(in) :: x(:, :)
    real(wp), dimension(self%n_dof, self%n_dof) :: largest, strongest
    call self%find_motion(system, x, largest, strongest)
  end subroutine vary

  !> Local stiffness along a motion; `ready` if it is in the range of numbers.
  subroutine find_motion(self, system, x, largest, strongest)
    class(condensed_hill), intent(inout) :: self
    class(structure_type), intent(in) :: system
    real(wp), intent(in) :: x(:, :)
    real(wp), intent(out) :: largest(:, :), strongest(:, :)
    call self%sample(system, x)
    call self%find_local(system, largest, strongest)
    self%ready = max(maxval(largest), maxval(strongest)) <= sqrt(huge(1.0_wp))
  end subroutine find_motion

  !> Count exponents right of another line; the orders contain all poles up to a modulus.
  subroutine count_from(self, system, line, fastest)
    class(condensed_hill), intent(inout) :: self
    class(structure_type), intent(in) :: system
    !> (1/s), (rad/s).
    real(wp), intent(in) :: line, fastest
    self%line = line
    call self%poles%count_from(line)
    self%n_apart = self%poles%n_growing
    self%poles%fastest = max(self%poles%fastest, fastest)
    call self%find_orders(system)
  end subroutine count_from

  !> J, and the largest it is at any time, part by part: by deflections, and by rates.
  subroutine find_local(self, system, largest, strongest)
    class(condensed_hill), intent(inout) :: self
    class(structure_type), intent(in) :: system
    real(wp), intent(out) :: largest(:, :), strongest(:, :)
    complex(wp) :: moments(2*((size(self%u, 1) - 1)/2) + 1)
    real(wp) :: peak, constant
    integer :: a, b, j, most, q
    most = (size(self%u, 1) - 1)/2
    if (allocated(self%local)) deallocate (self%local)
    allocate (self%local(self%n_dof, self%n_dof, -most:most, size(self%kernel_of_group)), &
              source=(0.0_wp, 0.0_wp))
    largest = abs(self%without)
    do j = 1, size(self%slopes, 2)
      q = self%group(j)
      do b = 1, self%n_dof
        constant = merge(system%gather(j, b), 0.0_wp, system%kernel_of(j) > 0)
        peak = abs(constant)
        if (system%bent(j)) peak = maxval(abs(self%slopes(:, j, b) + constant))
        if (.not. peak > 0.0_wp) cycle
        largest(:, b) = largest(:, b) + abs(system%spread(:, j))*peak
        call moments_of(self%waves, system%bent(j), self%slopes(:, j, b), constant, moments)
        do a = 1, self%n_dof
          if (.not. abs(system%spread(a, j)) > 0.0_wp) cycle
          self%local(a, b, :, q) = self%local(a, b, :, q) + system%spread(a, j)*moments
        end do
      end do
    end do
    strongest = 0.0_wp
    if (system%n_rates() > 0) then
      call waves_of_rates(system, self%group, self%slopes(:, :, self%n_dof + 1:), &
                          self%waves, self%by_rate, strongest)
    end if
    call measure_waves(self%local, self%by_rate, largest, strongest, self%sizes, self%parts)
    self%reach = findloc(self%parts > silent, .true., 1, back=.true.)
    call find_swings(self%local, self%swings, self%others)
  end subroutine find_local

  !> J from order l to order i, at s_l.
  pure function local_at(self, i, l, kept, s) result(block)
    class(condensed_hill), intent(in) :: self
    integer, intent(in) :: i, l
    !> What memory retains of each group at s_i.
    complex(wp), intent(in) :: kept(:), s
    complex(wp) :: block(self%n_dof, self%n_dof)
    integer :: q

    block = (0.0_wp, 0.0_wp)
    do q = 1, size(kept)
      block = block + kept(q)*self%local(:, :, i - l, q)
    end do
    if (allocated(self%by_rate)) then
      do q = 1, size(kept)
        block = block + (kept(q)*s)*self%by_rate(:, :, i - l, q)
      end do
    end if
    if (i == l) block = block - self%without
  end function local_at

  !> How many orders: beyond the poles that matter, and until a disturbance of order 1 at these
  !! reaches no further, Y_k = |H(i k nu)| sum_m |J_m| Y_(k-m).
  subroutine find_orders(self, system)
    class(condensed_hill), intent(inout) :: self
    class(structure_type), intent(in) :: system
    real(wp) :: reached(0:max_unknowns), admitted, part
    complex(wp) :: s, h(1, self%n_dof, self%n_dof)
    integer :: b, i, m, n

    self%ready = self%poles%fastest <= max_unknowns*self%nu
    if (.not. self%ready) return
    b = ceiling(self%poles%fastest/self%nu + 0.5_wp*self%stride)
    if (self%stride == 2 .and. mod(b, 2) == 0) b = b + 1
    reached = 1.0_wp
    i = 0
    do
      ! One below the lowest, so that orders are mirrored about d/2 too.
      self%n_orders = merge(b + 2, 2*b + 2, self%stride == 2)
      n = self%n_orders*self%n_dof
      self%ready = n <= max_unknowns
      if (.not. self%ready) return
      associate (radius => (b + 3*self%stride)*self%nu)
        if (.not. self%band%serves(radius, self%nearness)) then
          call new_band(self%band, system%rest, radius, self%nearness)
        end if
      end associate
      s = cmplx(0.0_wp, (b + 0.5_wp*self%stride)*self%nu, wp)
      call self%band%evaluate([s], h)
      part = strength(system, self%kernel_of_group, self%slopes, s, h(1, :, :))
      ! Order b + stride.
      i = i + 1
      reached(i) = 0.0_wp
      do m = 1, self%reach
        ! Of large motions it grows by factors for many orders.
        reached(i) = min(reached(i) + part*self%parts(m)*reached(max(i - m, 0)), 1.0e100_wp)
      end do
      admitted = merge(accurate, fair, n < few_unknowns)
      if (part <= negligible .and. (maxval(reached(max(i - self%reach + 1, 0):i)) &
                                          <= admitted .or. n >= many_unknowns)) exit
      b = b + self%stride
    end do
    self%highest = b
    n = n + size(self%band%rigid_squares)
    if (allocated(self%re)) then
      if (size(self%re, 2) == n) return
      deallocate (self%re, self%im)
    end if
    ! Columns are filled in whole registers.
    allocate (self%re(n + n_lanes, n), self%im(n + n_lanes, n))
  end subroutine find_orders

  !> H at any s.
  subroutine compliances(self, system, s, h)
    class(condensed_hill), intent(in) :: self
    class(structure_type), intent(in) :: system
    complex(wp), intent(in) :: s(:)
    !> Shape (size(s), n_dof, n_dof).
    complex(wp), intent(out) :: h(:, :, :)
    integer :: i

    if (self%band%contains_all(s)) then
      call self%band%evaluate(s, h)
    else
      do i = 1, size(s)
        call system%rest%evaluate(s(i), h(i, :, :))
      end do
    end if
  end subroutine compliances

  subroutine without_poles(self, lambda, value)
    class(condensed_hill), intent(in) :: self
    complex(wp), intent(in) :: lambda
    complex(wp), intent(inout) :: value
    call self%poles%multiplied%multiply(lambda, value)
  end subroutine without_poles

  !> F of the p highest orders, from the lowest of these, but for most of the poles.
  subroutine of_orders(self, system, p, lowest, lambda, value)
    class(condensed_hill), intent(inout) :: self
    class(oscillator_type), intent(in) :: system
    integer, intent(in) :: p, lowest
    complex(wp), intent(in) :: lambda
    complex(wp), intent(out) :: value
    complex(wp), dimension(self%n_orders) :: s
    complex(wp) :: h(self%n_orders, self%n_dof, self%n_dof)
    complex(wp) :: kept(self%n_orders, size(self%kernel_of_group)), factor
    integer :: centre, n, width, i

    s(:p) = [(lambda + cmplx(0.0_wp, (lowest + (i - 1)*self%stride)*self%nu, wp), i=1, p)]
    kept(:p, :) = retained_of(system, self%kernel_of_group, s(:p))
    ! Rigid bodies are near their poles at order 0, or -1 of odd ones.
    centre = p - (self%highest + merge(1, 0, self%stride == 2))/self%stride
    n = p*self%n_dof + size(self%band%rigid_squares)
    width = (self%reach + 1)*self%n_dof - 1 + size(self%band%rigid_squares)
    factor = (0.0_wp, 0.0_wp)
    if (n > p .and. n == p*self%n_dof .and. .not. allocated(self%by_rate)) then
      call self%fill_swings(s(:p), kept(:p, :), factor)
    end if
    if (abs(factor) > 0.0_wp) then
      n = p*size(self%swings)
      width = (self%reach + 1)*size(self%swings) - 1
    else
      call self%band%evaluate(s(:p), h(:p, :, :))
      if (n == p .and. .not. allocated(self%by_rate)) then
        call fill_one(p, self%reach, size(self%re, 1), h(:p, 1, 1), kept(:p, :), self%local, &
                      ubound(self%local, 3), self%without(1, 1), self%re, self%im)
      else
        call fill(self, p, centre, h, kept, s(centre))
      end if
    end if
    call band_determinant(n, size(self%re, 1), max(min(n - 1, width), 0), self%re, self%im, value)
    if (abs(factor) > 0.0_wp) value = value*factor
    value = value*self%poles%rigid_factor(s(centre), self%period)
  end subroutine of_orders

  !> I + H J_0 at s, J_0 the mean along the motion.
  function mean_system_at(self, system, s, h) result(matrix)
    class(condensed_hill), intent(in) :: self
    class(oscillator_type), intent(in) :: system
    complex(wp), intent(in) :: s, h(:, :)
    complex(wp) :: matrix(self%n_dof, self%n_dof), kept(1, size(self%kernel_of_group))
    integer :: a

    if (self%remembers .or. allocated(self%by_rate)) then
      kept = retained_of(system, self%kernel_of_group, [s])
      matrix = matmul(h, self%local_at(0, 0, kept(1, :), s))
    else
      matrix = matmul(h, sum(self%local(:, :, 0, :), 3))
    end if
    do a = 1, self%n_dof
      matrix(a, a) = matrix(a, a) + 1.0_wp
    end do
  end function mean_system_at

  !> det(I + H J_0) at s = lambda, where relaxed springs push.
  complex(wp) function relaxation(self, system, lambda) result(ratio)
    class(condensed_hill), intent(in) :: self
    class(oscillator_type), intent(in) :: system
    complex(wp), intent(in) :: lambda
    complex(wp) :: s

    ratio = (1.0_wp, 0.0_wp)
    if (.not. self%pushes) return
    s = lambda
    if (self%stride == 2) s = lambda - cmplx(0.0_wp, 0.5_wp*self%period, wp)
    select type (system)
    class is (structure_type)
      call average(self, system, s, ratio)
    end select
  end function relaxation

  !> det(I + H J_0) at s: exponents of the mean system are zeros.
  subroutine average(self, system, s, value)
    class(condensed_hill), intent(in) :: self
    class(structure_type), intent(in) :: system
    complex(wp), intent(in) :: s
    complex(wp), intent(out) :: value
    complex(wp), dimension(self%n_dof, self%n_dof) :: matrix, h
    real(wp), dimension(self%n_dof, self%n_dof) :: re, im

    call system%rest%evaluate(s, h)
    matrix = mean_system_at(self, system, s, h)
    if (self%n_dof == 1) then
      value = matrix(1, 1)
      return
    end if
    re = real(matrix)
    im = aimag(matrix)
    call band_determinant(self%n_dof, self%n_dof, self%n_dof - 1, re, im, value)
  end subroutine average

  !> By how much, about, J - J_0 moves an exponent s of the mean system: through its neighbours at
  !! s + i m d, R sum_m |J_m|^2 |H_J(s + i m d)| with R/(s' - s) the part of
  !! H_J = (I + H J_0)^-1 H near s.
  subroutine moved_by_waves(self, system, s, distance, moved)
    class(condensed_hill), intent(in) :: self
    class(structure_type), intent(in) :: system
    complex(wp), intent(in) :: s
    !> Not distinguishable from s.
    real(wp), intent(in) :: distance
    real(wp), intent(out) :: moved
    complex(wp) :: places(2*self%reach + 1)
    complex(wp) :: h(2*self%reach + 1, self%n_dof, self%n_dof)
    real(wp) :: next, both, size_of
    integer :: waves(self%reach), i, m, n

    n = 0
    do m = 1, self%reach
      if (self%parts(m) <= faint) cycle
      n = n + 1
      waves(n) = m
      places(2*n) = s + cmplx(0.0_wp, m*self%period, wp)
      places(2*n + 1) = 2.0_wp*s - places(2*n)
    end do
    places(1) = s + distance
    call self%compliances(system, places(:2*n + 1), h(:2*n + 1, :, :))
    moved = 0.0_wp
    do i = 1, n
      m = waves(i)
      both = 0.0_wp
      call add(2*i)
      call add(2*i + 1)
      ! Strong waves come back more than once.
      size_of = self%sizes(m)
      if (allocated(self%by_rate)) then
        size_of = size_of + (abs(s) + m*self%period) &
                  *maxval(sum(abs(sum(self%by_rate(:, :, m, :), 3)), 2))
      end if
      next = size_of*both
      moved = moved + size_of*next*(1.0_wp + next)
    end do
    both = 0.0_wp
    call add(1)
    moved = moved*both*distance

  contains

    subroutine add(i)
      integer, intent(in) :: i
      complex(wp), dimension(self%n_dof, self%n_dof) :: matrix, inverse
      logical :: singular
      if (self%n_dof == 1 .and. .not. (self%remembers .or. allocated(self%by_rate))) then
        both = both + abs(h(i, 1, 1)/(1.0_wp + h(i, 1, 1)*sum(self%local(1, 1, 0, :))))
        return
      end if
      matrix = mean_system_at(self, system, places(i), h(i, :, :))
      call invert(matrix, inverse, singular)
      if (singular) both = huge(1.0_wp)**0.25_wp
      if (.not. singular) both = both + maxval(sum(abs(matmul(inverse, h(i, :, :))), 2))
    end subroutine add

  end subroutine moved_by_waves

  subroutine mean_system(self, system, s, matrix)
    class(condensed_hill), intent(in) :: self
    class(oscillator_type), intent(in) :: system
    real(wp), intent(in) :: s
    real(wp), allocatable, intent(out) :: matrix(:, :)
    complex(wp) :: h(self%n_dof, self%n_dof)

    select type (system)
    class is (structure_type)
      call system%rest%evaluate(cmplx(s, 0.0_wp, wp), h)
      matrix = real(mean_system_at(self, system, cmplx(s, 0.0_wp, wp), h))
    end select
  end subroutine mean_system

  subroutine on_line(self, system, lambda, value)
    class(condensed_hill), intent(inout) :: self
    class(oscillator_type), intent(in) :: system
    complex(wp), intent(in) :: lambda
    complex(wp), intent(out) :: value
    call self%determinant(system, lambda, value, aimag(lambda) > 0.25_wp*self%period)
  end subroutine on_line

  !> I + J H' over the deflections that swing.
  subroutine fill_swings(self, s, kept, factor)
    class(condensed_hill), intent(inout) :: self
    complex(wp), intent(in) :: s(:), kept(:, :)
    !> What its determinant lacks; 0: not to be had so.
    complex(wp), intent(out) :: factor
    real(wp), dimension(size(s), size(self%swings), size(self%swings)) :: soft_re, soft_im
    real(wp), dimension(size(s), size(self%swings), size(self%swings)) :: own_re, own_im
    complex(wp) :: h(size(s), self%n_dof, self%n_dof)

    factor = (0.0_wp, 0.0_wp)
    if (size(self%others) == 0) return
    call self%band%evaluate(s, h)
    call soften(h, kept, real(self%local(:, :, 0, :)), self%without, self%swings, self%others, &
                soft_re, soft_im, own_re, own_im, factor)
    if (.not. abs(factor) > 0.0_wp) return
    call fill_waves(size(s), self%reach, size(self%re, 1), self%swings, kept, self%local, soft_re, &
                    soft_im, own_re, own_im, self%re, self%im)
  end subroutine fill_swings

  !> I + H J, order by order; behind the order of the rigid bodies one row and column for each.
  subroutine fill(self, p, centre, h, kept, s)
    class(condensed_hill), intent(inout) :: self
    integer, intent(in) :: p, centre
    complex(wp), intent(in) :: h(:, :, :), kept(:, :), s
    complex(wp) :: block(self%n_dof, self%n_dof), entry
    integer :: a, b, c, i, k, l, n, row, column, extra

    n = self%n_dof
    extra = size(self%band%rigid_squares)
    self%re = 0.0_wp
    self%im = 0.0_wp
    do l = 1, p
      column = (l - 1)*n + merge(extra, 0, l > centre)
      do i = max(1, l - self%reach), min(p, l + self%reach)
        row = (i - 1)*n + merge(extra, 0, i > centre)
        block = self%local_at(i, l, kept(i, :), &
                         s + cmplx(0.0_wp, (l - centre)*self%stride*self%nu, wp))
        do c = 1, n
          do a = 1, n
            entry = (0.0_wp, 0.0_wp)
            do b = 1, n
              entry = entry + h(i, a, b)*block(b, c)
            end do
            if (i == l .and. a == c) entry = entry + 1.0_wp
            self%re(row + a, column + c) = real(entry)
            self%im(row + a, column + c) = aimag(entry)
          end do
          if (i /= centre) cycle
          do k = 1, extra
            entry = -sum(self%band%rigid_pushed(k, :)*block(:, c))
            self%re(centre*n + k, column + c) = real(entry)
            self%im(centre*n + k, column + c) = aimag(entry)
          end do
        end do
      end do
    end do
    do k = 1, extra
      self%re((centre - 1)*n + 1:centre*n, centre*n + k) = self%band%rigid_seen(k, :)
      entry = self%band%rigid_squares(k) + (self%band%rigid_rates(k) + s)*s
      self%re(centre*n + k, centre*n + k) = real(entry)
      self%im(centre*n + k, centre*n + k) = aimag(entry)
    end do
    ! Rigid bodies at the other orders.
    do i = 1, merge(p, 0, extra > 0)
      if (i == centre) cycle
      call add_rigid(self, p, centre, i, s + cmplx(0.0_wp, (i - centre)*self%stride*self%nu, wp), &
                     kept)
    end do
  end subroutine fill

  !> What the rigid bodies add to the rows of another order.
  subroutine add_rigid(self, p, centre, i, s, kept)
    class(condensed_hill), intent(inout) :: self
    integer, intent(in) :: p, centre, i
    complex(wp), intent(in) :: s, kept(:, :)
    complex(wp) :: h(self%n_dof, self%n_dof), block(self%n_dof, self%n_dof)
    integer :: a, b, l, n, row, column, extra

    n = self%n_dof
    extra = size(self%band%rigid_squares)
    do b = 1, n
      do a = 1, n
        h(a, b) = sum(self%band%rigid_seen(:, a)*self%band%rigid_pushed(:, b) &
                      /(self%band%rigid_squares + (self%band%rigid_rates + s)*s))
      end do
    end do
    row = (i - 1)*n + merge(extra, 0, i > centre)
    do l = max(1, i - self%reach), min(p, i + self%reach)
      column = (l - 1)*n + merge(extra, 0, l > centre)
      block = matmul(h, self%local_at(i, l, kept(i, :), &
                                 s + cmplx(0.0_wp, (l - i)*self%stride*self%nu, wp)))
      self%re(row + 1:row + n, column + 1:column + n) = &
        self%re(row + 1:row + n, column + 1:column + n) + real(block)
      self%im(row + 1:row + n, column + 1:column + n) = &
        self%im(row + 1:row + n, column + 1:column + n) + aimag(block)
    end do
  end subroutine add_rigid

end module viscovib_condensed_hill
