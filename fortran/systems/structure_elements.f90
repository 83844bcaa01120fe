!> Local elements of a structure, and the independent directions in which they act.
module viscovib_structure_elements
  use, intrinsic :: iso_fortran_env, only: real128
  use viscovib_kinds, only: wp
  use viscovib_law_term, only: law_term
  use viscovib_polynomial, only: max_degree, polynomial_parameters
  implicit none
  private

  public :: add_elements, element_type, find_directions, put_laws

  !> (1 - R*) [k d + f(d)] + c d' along e, d = e . u.
  type :: element_type
    !> e, shape (n_places).
    real(wp), allocatable :: direction(:)
    real(wp) :: stiffness = 0.0_wp, damping = 0.0_wp
    !> Spring in series with a fluid damper, coefficient and exponent of the damper, and the rate r
    !! of the internal coordinate s, along which e is; 0: none. The force is series(1) (s' + r s).
    real(wp) :: series(4) = 0.0_wp
    !> Direction of the deflection of spring and damper in series; not allocated: e.
    real(wp), allocatable :: across(:)
    !> Weights of supports in the deflection, shape (n_supports); not allocated: none.
    real(wp), allocatable :: ends(:)
    !> Coefficients of f by power of d; one law of d without its linear part for a nonpolynomial
    !! force, or none.
    real(wp) :: powers(2:max_degree) = 0.0_wp
    type(law_term), allocatable :: laws(:)
    !> 0: none.
    integer :: kernel = 0
    !> True if the element exerts no force and only observes its deflection.
    logical :: is_watched = .false.
    !> e in terms of the independent directions, shape (n_directions), if the element is active.
    real(wp), allocatable :: mix(:)
  contains
    procedure :: is_active
  end type element_type

  !> A direction with a smaller independent part counts as dependent; smaller weights count as
  !! rounding errors.
  real(wp), parameter :: dependent = 1.0e-9_wp, no_weight = 1.0e-12_wp

contains

  !> True if the element is not purely elastic, or observes its deflection.
  pure logical function is_active(self)
    class(element_type), intent(in) :: self
    is_active = self%is_watched .or. size(self%laws) > 0 .or. any(abs(self%powers) > 0.0_wp) &
                .or. (self%kernel > 0 .and. abs(self%stiffness) > 0.0_wp)
  end function is_active

  !> Add the linear parts of elements to K and C.
  pure subroutine add_elements(elements, places, stiffness, damping, low)
    type(element_type), intent(in) :: elements(:)
    !> Observed coordinates in terms of all coordinates, shape (n_places, n).
    real(wp), intent(in) :: places(:, :)
    real(wp), intent(inout) :: stiffness(:, :), damping(:, :)
    !> Rounding error of K: digits of soft springs in the presence of a stiff element.
    real(wp), intent(out), optional :: low(:, :)
    real(real128), allocatable :: total(:, :)
    real(wp) :: e(size(stiffness, 1))
    integer :: a, i, n

    n = merge(size(stiffness, 1), 0, present(low))
    allocate (total(n, n))
    if (present(low)) total(:, :) = real(stiffness, real128)
    do i = 1, size(elements)
      e = matmul(elements(i)%direction, places)
      do a = 1, size(e)
        stiffness(:, a) = stiffness(:, a) + elements(i)%stiffness*e(a)*e
        damping(:, a) = damping(:, a) + elements(i)%damping*e(a)*e
        if (.not. (present(low) .and. abs(e(a)) > 0.0_wp)) cycle
        total(:, a) = total(:, a) + real(elements(i)%stiffness, real128)*e(a)*e
      end do
    end do
    if (present(low)) low = real(total - stiffness, wp)
  end subroutine add_elements

  !> Find independent directions of the active elements, and express each element in them.
  pure subroutine find_directions(elements, n, directions)
    type(element_type), intent(inout) :: elements(:)
    !> Number of observed coordinates.
    integer, intent(in) :: n
    !> Shape (n, q). Without active elements, the first coordinate represents the linear response.
    real(wp), allocatable, intent(out) :: directions(:, :)
    real(wp) :: chosen(n, size(elements)), basis(n, size(elements)), r(size(elements), &
                                                                       size(elements))
    real(wp) :: left(n), weights(size(elements)), one(n)
    integer :: i, j, q, pass

    q = 0
    r = 0.0_wp
    do i = 1, size(elements)
      if (.not. elements(i)%is_active()) cycle
      ! Orthogonalize against previous directions twice, to remove rounding errors.
      left = elements(i)%direction
      weights = 0.0_wp
      do pass = 1, 2
        do j = 1, q
          associate (part => sum(basis(:, j)*left))
            weights(j) = weights(j) + part
            left = left - part*basis(:, j)
          end associate
        end do
      end do
      if (norm2(left) <= dependent*norm2(elements(i)%direction)) then
        do j = q, 1, -1
          weights(j) = (weights(j) - sum(r(j, j + 1:q)*weights(j + 1:q)))/r(j, j)
        end do
        where (abs(weights) <= no_weight*maxval(abs(weights))) weights = 0.0_wp
      else
        q = q + 1
        chosen(:, q) = elements(i)%direction
        r(:q - 1, q) = weights(:q - 1)
        r(q, q) = norm2(left)
        basis(:, q) = left/r(q, q)
        weights = 0.0_wp
        weights(q) = 1.0_wp
      end if
      elements(i)%mix = weights
    end do
    do i = 1, size(elements)
      if (allocated(elements(i)%mix)) elements(i)%mix = elements(i)%mix(:q)
    end do
    directions = chosen(:, :q)
    if (q > 0) return
    one = 0.0_wp
    one(1) = 1.0_wp
    directions = reshape(one, [n, 1])
  end subroutine find_directions

  !> Forces of the elements on q coordinates as a polynomial system. Elastic stiffness belongs to
  !! the linear subsystem; only its hereditary part is included here.
  pure subroutine put_laws(elements, q, n_kernels, p)
    type(element_type), intent(in) :: elements(:)
    integer, intent(in) :: q, n_kernels
    type(polynomial_parameters), intent(inout) :: p
    integer :: a, i, j, k, n, power

    allocate (p%stiffness(q, q, n_kernels + 1), source=0.0_wp)
    p%spring_kernel = [(i, i=0, n_kernels)]
    n = 0
    do i = 1, size(elements)
      if (allocated(elements(i)%mix)) n = n + terms_of(elements(i))
    end do
    allocate (p%coefficient(n), p%on(n), p%monomial_kernel(n), p%powers(q, n))
    n = 0
    do i = 1, size(elements)
      associate (one => elements(i))
        if (.not. allocated(one%mix)) cycle
        if (one%kernel > 0) then
          do a = 1, q
            p%stiffness(:, a, one%kernel + 1) = p%stiffness(:, a, one%kernel + 1) &
                                                + one%stiffness*one%mix(a)*one%mix
          end do
        end if
        do power = 2, max_degree
          if (abs(one%powers(power)) > 0.0_wp) call put_power(one, power, p, n)
        end do
      end associate
    end do
    allocate (p%laws(sum([(size(elements(i)%laws), i=1, size(elements))])))
    k = 0
    do i = 1, size(elements)
      associate (mix => elements(i)%mix)
        do j = 1, size(elements(i)%laws)
          k = k + 1
          p%laws(k) = elements(i)%laws(j)
          p%laws(k)%kernel = elements(i)%kernel
          p%laws(k)%arguments = matmul(p%laws(k)%arguments, reshape(mix, [1, q]))
          p%laws(k)%rates = matmul(p%laws(k)%rates, reshape(mix, [1, q]))
          p%laws(k)%equations = pack([(a, a=1, q)], abs(mix) > 0.0_wp)
          p%laws(k)%weights = pack(mix, abs(mix) > 0.0_wp)
          p%laws(k)%variables = spread(0, 1, size(p%laws(k)%equations))
        end do
      end associate
    end do
  end subroutine put_laws

  !> Number of monomials of an element.
  pure integer function terms_of(element) result(n)
    type(element_type), intent(in) :: element
    integer :: i, m, power
    real(wp) :: ways
    m = count(abs(element%mix) > 0.0_wp)
    n = 0
    do power = 2, max_degree
      if (.not. abs(element%powers(power)) > 0.0_wp) cycle
      ways = 1.0_wp
      do i = 1, power
        ways = ways*(m - 1 + i)/i
      end do
      n = n + m*nint(min(ways, 1.0e6_wp))
    end do
  end function terms_of

  !> mix_a c (sum_b mix_b y_b)^power on each equation a, by the multinomial theorem.
  pure subroutine put_power(element, power, p, n)
    type(element_type), intent(in) :: element
    integer, intent(in) :: power
    type(polynomial_parameters), intent(inout) :: p
    !> Number of monomials so far.
    integer, intent(inout) :: n
    integer, allocatable :: places(:), exponents(:)
    real(wp) :: factor
    integer :: a, i, first

    places = pack([(i, i=1, size(element%mix))], abs(element%mix) > 0.0_wp)
    allocate (exponents(size(places)), source=0)
    exponents(1) = power
    do
      factor = element%powers(power)*gamma(power + 1.0_wp)
      do i = 1, size(places)
        factor = factor*element%mix(places(i))**exponents(i)/gamma(exponents(i) + 1.0_wp)
      end do
      do a = 1, size(places)
        n = n + 1
        p%coefficient(n) = factor*element%mix(places(a))
        p%on(n) = places(a)
        p%monomial_kernel(n) = element%kernel
        p%powers(:, n) = 0
        p%powers(places, n) = exponents
      end do
      ! Next set of exponents with the same sum.
      first = findloc(exponents > 0, .true., 1)
      if (first == size(places)) exit
      i = exponents(first)
      exponents(first) = 0
      exponents(1) = i - 1
      exponents(first + 1) = exponents(first + 1) + 1
    end do
  end subroutine put_power

end module viscovib_structure_elements
