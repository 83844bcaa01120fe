!> Stability of condensed structures: the count by the determinant of the elements against
!! multipliers of the full system, or Hill's determinant of the full system with memory.
module test_condensed
  use, intrinsic :: ieee_arithmetic, only: ieee_is_nan
  use testing, only: begin, check, check_close, check_ok
  use viscovib_catalogue, only: kernel_abel, kernel_prony, kernel_rabotnov, new_kernel
  use viscovib_constants, only: pi
  use viscovib_compliance, only: compliance_type
  use viscovib_compliance_band, only: compliance_band, new_band
  use viscovib_counters, only: counting
  use viscovib_harmonic_set, only: harmonic_set_type, new_harmonic_set
  use viscovib_kernel_holder, only: kernel_holder
  use viscovib_kinds, only: wp
  use viscovib_motion_stability, only: stability_checker, new_stability_checker, stability_type
  use viscovib_polynomial, only: new_polynomial, polynomial_parameters, polynomial_type
  use viscovib_status, only: status_type
  use viscovib_structure, only: structure_type
  implicit none
  private

  public :: run_condensed

  !> Random systems, each with some neighbouring motions. The debug build takes ten times as long
  !! per system, so it checks fewer systems than the release build.
  integer, parameter :: n_systems = merge(16, 60, counting), n_motions = 4
  real(wp) :: seed = 12345.0_wp

  type :: tally_type
    integer :: checked = 0, unstable = 0, unknown = 0, wrong = 0, compared = 0, certain = 0
    real(wp) :: error = 0.0_wp
  end type tally_type

contains

  subroutine run_condensed()
    if (begin('modes beyond a frequency are one polynomial')) call band()
    if (begin('as many grow as multipliers of the whole say')) call random_systems(.false.)
    if (begin('as many grow with memory as of the whole')) call random_systems(.true.)
  end subroutine run_condensed

  !> Uniformly distributed in 0 to 1; the same sequence in each run.
  real(wp) function random()
    seed = modulo(16807.0_wp*seed, 2147483647.0_wp)
    random = seed/2147483647.0_wp
  end function random

  real(wp) function between(low, high)
    real(wp), intent(in) :: low, high
    between = low + (high - low)*random()
  end function between

  !> n random orthonormal columns.
  subroutine random_rotation(q)
    real(wp), intent(out) :: q(:, :)
    integer :: i, j
    do j = 1, size(q, 2)
      do i = 1, size(q, 1)
        q(i, j) = between(-1.0_wp, 1.0_wp)
      end do
      do i = 1, j - 1
        q(:, j) = q(:, j) - dot_product(q(:, i), q(:, j))*q(:, i)
      end do
      q(:, j) = q(:, j)/norm2(q(:, j))
    end do
  end subroutine random_rotation

  subroutine band()
    type(compliance_type) :: rest
    type(compliance_band) :: some
    complex(wp) :: h(3, 2, 2), whole(2, 2), s(3), scale
    integer :: i, k

    rest%squares = [(0.01_wp*i**2, i=0, 199)]
    rest%rates = [(0.002_wp*i, i=0, 199)]
    rest%rates(150) = 200.0_wp
    rest%losses = 0.0_wp*rest%rates
    allocate (rest%seen(200, 2), rest%pushed(200, 2), rest%poles(0), rest%left(0, 2), &
              rest%right(0, 2))
    do i = 1, 200
      rest%seen(i, :) = [between(-1.0_wp, 1.0_wp), between(-1.0_wp, 1.0_wp)]
    end do
    rest%pushed = rest%seen
    allocate (rest%flexibility(2, 2), source=0.1_wp)
    allocate (rest%flexibility_rate(2, 2), source=0.01_wp)
    call rest%complete()
    call new_band(some, rest, 1.0_wp, 1.0e-3_wp)
    call check(size(some%squares) < 70, 'few modes one by one')
    call check(size(some%rigid_squares) == 1, 'the rigid body is apart')
    s = [(0.1_wp, 0.3_wp), (-0.2_wp, 0.7_wp), (0.0_wp, 1.0_wp)]
    call some%evaluate(s, h)
    do k = 1, 3
      call rest%evaluate(s(k), whole)
      do i = 1, 2
        scale = sum(some%rigid_seen(1, :)*some%rigid_pushed(1, i))
        h(k, :, i) = h(k, :, i) + some%rigid_seen(1, :)*some%rigid_pushed(1, i)/s(k)**2
      end do
      call check(maxval(abs(h(k, :, :) - whole)) <= 1.0e-12_wp*maxval(abs(whole)) &
                 .and. abs(scale) > 0.0_wp, 'the same')
    end do
  end subroutine band

  !> A system of n coordinates with elements on the first r: full and condensed.
  subroutine random_system(remembers, whole, structure, n, r)
    logical, intent(in) :: remembers
    type(polynomial_type), intent(out) :: whole
    type(structure_type), intent(out) :: structure
    integer, intent(out) :: n, r
    type(polynomial_parameters) :: p, q
    type(kernel_holder), allocatable :: kernels(:)
    type(status_type) :: status
    real(wp), allocatable :: shapes(:, :), squares(:), rates(:)
    real(wp) :: damping, rate
    integer :: i, j, k, kind, m, monomials

    n = 2 + int(4.0_wp*random())
    r = 1 + int(min(3, n)*random())
    kind = int(6.0_wp*random())
    damping = 10.0_wp**between(-3.0_wp, -1.0_wp)
    allocate (shapes(n, n), squares(n), rates(n))
    call random_rotation(shapes)
    do i = 1, n
      squares(i) = between(0.3_wp, 3.0_wp)**2
      rates(i) = 2.0_wp*damping*sqrt(squares(i))*between(0.5_wp, 1.5_wp)
    end do
    ! Negative stiffness, a rigid body, negative damping, a mode without motion at the elements.
    if (kind == 0) squares(1) = -squares(1)
    if (kind == 1) squares(1) = 0.0_wp
    if (kind == 1) rates(1) = merge(0.0_wp, 0.05_wp, random() < 0.5_wp)
    if (kind == 2) rates(1) = -0.3_wp*rates(1)
    allocate (kernels(merge(1, 0, remembers)))
    if (remembers) then
      rate = 10.0_wp**between(-2.0_wp, 0.5_wp)
      if (random() < 0.4_wp) then
        call new_kernel(kernels(1)%kernel, kernel_rabotnov, [0.1_wp*rate**0.6_wp, 0.6_wp, &
                                                             rate**0.6_wp], status)
      else if (random() < 0.3_wp) then
        call new_kernel(kernels(1)%kernel, kernel_abel, [0.05_wp, 0.3_wp], status)
      else
        call new_kernel(kernels(1)%kernel, kernel_prony, &
                        [between(0.02_wp, 0.5_wp)*rate, 0.1_wp, rate, 2.0_wp], status)
      end if
      call check_ok(status)
    end if
    m = size(kernels)
    monomials = 2*r + int(3.0_wp*random())
    allocate (q%mass(r, r), q%damping(r, r), q%base_direction(r), q%stiffness(r, r, m), &
              q%spring_kernel(m), q%coefficient(monomials), q%on(monomials), &
              q%monomial_kernel(monomials), q%powers(r, monomials))
    q%mass = 0.0_wp
    q%damping = 0.0_wp
    q%base_direction = 0.0_wp
    q%stiffness = 0.0_wp
    q%powers = 0
    q%spring_kernel = 1
    do i = 1, r
      q%mass(i, i) = 1.0_wp
      if (remembers) q%stiffness(i, i, 1) = max(between(-0.5_wp, 1.0_wp), 0.0_wp)
    end do
    do j = 1, monomials
      q%coefficient(j) = between(-0.5_wp, 1.0_wp)
      q%on(j) = merge(j, 1 + int(r*random()), j <= r)
      q%monomial_kernel(j) = merge(int(2.0_wp*random()), 0, remembers)
      ! Odd powers, so that motions may have half-wave symmetry.
      i = 1 + int(r*random())
      q%powers(q%on(j), j) = 1
      q%powers(i, j) = q%powers(i, j) + 2
    end do
    allocate (p%mass(n, n), p%stiffness(n, n, m + 1), p%base_direction(n), p%powers(n, monomials))
    p%mass = 0.0_wp
    p%base_direction = 0.0_wp
    p%powers = 0
    p%powers(:r, :) = q%powers
    p%coefficient = q%coefficient
    p%on = q%on
    p%monomial_kernel = q%monomial_kernel
    p%spring_kernel = [0, q%spring_kernel]
    p%stiffness = 0.0_wp
    p%stiffness(:r, :r, 2:) = q%stiffness
    do i = 1, n
      p%mass(i, i) = 1.0_wp
    end do
    p%damping = matmul(shapes, spread(rates, 2, n)*transpose(shapes))
    p%stiffness(:, :, 1) = matmul(shapes, spread(squares, 2, n)*transpose(shapes))
    ! The full stiffness contains the linear part of the elements: it is subtracted here.
    do k = 1, m
      p%stiffness(:r, :r, 1) = p%stiffness(:r, :r, 1) - q%stiffness(:, :, k)
    end do
    call new_polynomial(whole, p, kernels, status)
    call check_ok(status)
    call new_polynomial(structure%polynomial_type, q, kernels, status)
    call check_ok(status)
    structure%rest%squares = squares
    structure%rest%rates = rates
    structure%rest%losses = 0.0_wp*rates
    structure%rest%seen = transpose(shapes(:r, :))
    structure%rest%pushed = structure%rest%seen
    allocate (structure%rest%poles(0), structure%rest%left(0, r), structure%rest%right(0, r))
    allocate (structure%rest%flexibility(r, r), source=0.0_wp)
    allocate (structure%rest%flexibility_rate(r, r), source=0.0_wp)
    call structure%rest%complete()
  end subroutine random_system

  subroutine random_systems(remembers)
    logical, intent(in) :: remembers
    type(polynomial_type) :: whole
    type(structure_type) :: structure
    type(harmonic_set_type) :: set
    type(stability_checker) :: of_whole, of_elements
    type(stability_type) :: expected, found
    type(tally_type) :: tally
    real(wp), allocatable :: x(:, :, :)
    complex(wp), allocatable :: known(:)
    real(wp) :: nu(n_motions), period
    integer :: a, b, k, l, n, r
    character(len=160) :: text

    do l = 1, n_systems
      call random_system(remembers, whole, structure, n, r)
      call new_harmonic_set(set, 3 + 2*int(2.0_wp*random()), random() < 0.5_wp, 3)
      if (allocated(x)) deallocate (x)
      allocate (x(2*size(set%orders), n, n_motions))
      nu = between(0.3_wp, 4.0_wp)
      do a = 1, n
        do b = 1, size(x, 1)
          x(b, a, :) = between(-1.0_wp, 1.0_wp)*0.5_wp**((b - 1)/2)
        end do
      end do
      x = x*between(0.1_wp, 1.5_wp)
      do k = 2, n_motions
        nu(k) = nu(1)*(1.0_wp + 0.03_wp*k)
        x(:, :, k) = x(:, :, 1)*(1.0_wp + 0.05_wp*k)
      end do
      call new_stability_checker(of_whole, whole, set)
      call new_stability_checker(of_elements, structure, set)
      call of_whole%check(whole, nu, x, expected)
      call of_elements%check(structure, nu, x(:, :r, :), found)
      do k = 1, n_motions
        period = merge(2.0_wp, 1.0_wp, set%half_wave)*nu(k)
        if (expected%n_growing(k) < 0) cycle
        ! Exponents that are too large, or too near to the imaginary axis.
        known = pack(expected%exponents(:, k),.not. ieee_is_nan(real(expected%exponents(:, k))))
        if (size(known) > 0) then
          if (maxval(real(known)) > 2.0_wp*nu(k)) cycle
          if (minval(abs(real(known))) < 1.0e-7_wp*nu(k)) cycle
        end if
        tally%checked = tally%checked + 1
        if (expected%n_growing(k) > 0) tally%unstable = tally%unstable + 1
        if (found%n_growing(k) < 0) then
          tally%unknown = tally%unknown + 1
        else if (found%n_growing(k) /= expected%n_growing(k)) then
          tally%wrong = tally%wrong + 1
          write (text, '(a,i0,a,i0,a,i0,a,i0,a,i0)') 'system ', l, ' motion ', k, ': ', &
            found%n_growing(k), ' grow, expected ', expected%n_growing(k), ', coordinates ', n
          call check(.false., trim(text))
        else if (.not. remembers) then
          call vary_motion(of_elements, of_whole, structure, whole, nu(k), x(:, :, k), r, &
                           found%exponents(:, k), expected%n_growing(k), tally%certain)
        end if
        if (found%n_growing(k) == expected%n_growing(k) .and. expected%n_growing(k) > 0 &
            .and. size(known) > 0) then
          if (ieee_is_nan(real(found%exponents(1, k)))) cycle
          tally%compared = tally%compared + 1
          tally%error = max(tally%error, &
                            minval(abs(exp(2.0_wp*pi/period*(known - found%exponents(1, k))) &
                                       - 1.0_wp)))
        end if
      end do
    end do
    call check(tally%wrong == 0, 'as many grow')
    call check(tally%unknown <= tally%checked/50, 'few are unknown')
    call check(tally%unstable > tally%checked/10, 'some grow')
    ! The first systems of the debug build have none.
    if (.not. (remembers .or. counting)) then
      call check(tally%certain > tally%checked/30, 'some stay for sure')
    end if
    ! With memory the exponents of the full system are less accurate.
    if (.not. remembers) call check_close(tally%error, 0.0_wp, 1.0e-6_wp, 'their rates', 1.0_wp)
  end subroutine random_systems

  !> Where it is certain that motions very near one are like it, multipliers of the whole say so on
  !! both sides of it.
  subroutine vary_motion(of_elements, of_whole, structure, whole, nu, x, r, exponents, n_growing, &
                         n_certain)
    type(stability_checker), intent(inout) :: of_elements, of_whole
    type(structure_type), intent(in) :: structure
    type(polynomial_type), intent(in) :: whole
    real(wp), intent(in) :: nu, x(:, :)
    integer, intent(in) :: r, n_growing
    complex(wp), intent(in) :: exponents(:)
    integer, intent(inout) :: n_certain
    type(stability_type) :: expected
    real(wp) :: nearby(size(x, 1), size(x, 2), 2), change, size_of, before
    integer :: a, b

    ! Other systems do not depend on this.
    before = seed
    size_of = 10.0_wp**between(-6.0_wp, -1.3_wp)*maxval(abs(x))
    do a = 1, size(x, 2)
      do b = 1, size(x, 1)
        change = between(-1.0_wp, 1.0_wp)*size_of
        nearby(b, a, 1) = x(b, a) + change
        nearby(b, a, 2) = x(b, a) - change
      end do
    end do
    seed = before
    if (.not. of_elements%stays(structure, nu, x(:, :r), nearby(:, :r, :1), exponents, n_growing, &
                                huge(1.0_wp))) return
    n_certain = n_certain + 1
    call of_whole%check(whole, [nu, nu], nearby, expected)
    call check(all(expected%n_growing == n_growing .or. expected%n_growing < 0), &
               'motions on both sides are like it')
  end subroutine vary_motion

end module test_condensed
