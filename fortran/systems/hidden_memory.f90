!> Replaces the memory of a polynomial system, with kernels that are sums of exponentials, by extra
!! coordinates.
!!
!! A force g with a kernel R(t) = sum_q w_q exp(-r_q t) is g - R*g (seed paper 001, (5)), and
!!
!!   R*g = sum_q w_q m z_q',   m z_q'' + m r_q z_q' - g = 0,   z_q(0) = z_q'(0) = 0.
!!
!! Each exponential of each force is a mass m that g drags through a dashpot. Its velocity gives the
!! force on the coordinate; no force depends on z_q itself. With m equal to the mass of the
!! coordinate on which g acts, z_q has the scale of the other coordinates. A law acts on these
!! masses too, without additional switching surfaces. Proportional forces, such as those on both
!! ends of a spring, share their masses.
module viscovib_hidden_memory
  use viscovib_kernel, only: kernel_type
  use viscovib_kernel_sum, only: kernel_sum
  use viscovib_kinds, only: wp
  use viscovib_law_term, only: law_term, read_rates
  use viscovib_polynomial, only: polynomial_type
  use viscovib_prony, only: prony_kernel
  use viscovib_status, only: show
  implicit none
  private

  public :: count_hidden, fades_by_exponentials, list_hidden, hidden_text, unfold_memory

  !> One exponential of the force in a hereditary variable.
  type :: dragged_mass
    !> The hereditary variable, and the coordinate on which it acts.
    integer :: variable = 0, on = 0
    real(wp) :: mass = 0.0_wp, weight = 0.0_wp, rate = 0.0_wp
  end type dragged_mass

contains

  !> Number of memory coordinates; -1: a kernel is not a sum of exponentials.
  integer function count_hidden(system) result(n)
    type(polynomial_type), intent(in) :: system
    type(dragged_mass), allocatable :: masses(:)
    integer :: k

    n = -1
    do k = 1, size(system%kernels)
      if (.not. any(system%kernel_of == k)) cycle
      if (.not. fades_by_exponentials(system%kernels(k)%kernel)) return
    end do
    call find_masses(system, masses)
    n = size(masses)
  end function count_hidden

  !> Hereditary variable, rate and mass of each memory coordinate.
  subroutine list_hidden(system, variables, rates, masses)
    type(polynomial_type), intent(in) :: system
    integer, allocatable, intent(out) :: variables(:)
    real(wp), allocatable, intent(out) :: rates(:), masses(:)
    type(dragged_mass), allocatable :: all_of_them(:)
    call find_masses(system, all_of_them)
    variables = all_of_them%variable
    rates = all_of_them%rate
    masses = all_of_them%mass
  end subroutine list_hidden

  !> Text of a plan: number of memory coordinates.
  pure function hidden_text(n_hidden) result(text)
    integer, intent(in) :: n_hidden
    character(len=:), allocatable :: text
    text = ''
    if (n_hidden > 0) text = ', '//show(n_hidden)//' of them exponentials of forces that remember'
  end function hidden_text

  !> True if a kernel is exactly a sum of exponentials.
  recursive pure logical function fades_by_exponentials(kernel) result(does)
    class(kernel_type), intent(in) :: kernel
    integer :: i
    does = .false.
    select type (kernel)
    type is (prony_kernel)
      does = .true.
    type is (kernel_sum)
      does = all([(fades_by_exponentials(kernel%parts(i)%kernel), i=1, size(kernel%parts))])
    end select
  end function fades_by_exponentials

  subroutine find_masses(system, masses)
    type(polynomial_type), intent(in) :: system
    type(dragged_mass), allocatable, intent(out) :: masses(:)
    type(dragged_mass) :: one
    real(wp), allocatable :: weights(:), rates(:)
    integer :: j, q, owner(system%n_memory())
    real(wp) :: share(system%n_memory())

    allocate (masses(0))
    call find_multiples(system, owner, share)
    do j = 1, system%n_memory()
      if (system%kernel_of(j) == 0 .or. owner(j) /= j) cycle
      ! These are the exact terms, independent of the arguments.
      call system%kernels(system%kernel_of(j))%exponentials(1.0_wp, 1.0_wp, 1.0_wp, weights, rates)
      one%variable = j
      one%on = maxloc(abs(system%spread(:, j)), 1)
      one%mass = system%mass(one%on, one%on)
      do q = 1, size(weights)
        if (.not. abs(weights(q)) > 0.0_wp) cycle
        one%weight = weights(q)
        one%rate = rates(q)
        masses = [masses, one]
      end do
    end do
  end subroutine find_masses

  !> For each force, the first force of which it is a multiple, and the factor.
  subroutine find_multiples(system, owner, share)
    type(polynomial_type), intent(in) :: system
    integer, intent(out) :: owner(:)
    real(wp), intent(out) :: share(:)
    real(wp) :: numbers(system%n_dof() + size(system%monomials) + size(system%laws), size(owner))
    integer :: i, j, k

    call find_numbers(system, numbers)
    owner = [(j, j=1, size(owner))]
    share = 1.0_wp
    do j = 2, size(owner)
      do i = 1, j - 1
        if (owner(i) /= i .or. system%kernel_of(i) /= system%kernel_of(j)) cycle
        k = maxloc(abs(numbers(:, i)), 1)
        if (.not. abs(numbers(k, i)) > 0.0_wp) cycle
        share(j) = numbers(k, j)/numbers(k, i)
        if (any(abs(numbers(:, j) - share(j)*numbers(:, i)) &
                > 4.0_wp*epsilon(1.0_wp)*abs(numbers(:, j)))) cycle
        owner(j) = i
        exit
      end do
      if (owner(j) == j) share(j) = 1.0_wp
    end do
  end subroutine find_multiples

  !> Coefficients of each force in columns: springs, monomials and laws.
  subroutine find_numbers(system, numbers)
    type(polynomial_type), intent(in) :: system
    real(wp), intent(out) :: numbers(:, :)
    integer :: i, j, k, n

    n = system%n_dof()
    numbers = 0.0_wp
    numbers(:n, :) = transpose(system%gather)
    do i = 1, size(system%monomials)
      associate (one => system%monomials(i))
        do k = 1, i
          if (size(system%monomials(k)%dof) /= size(one%dof)) cycle
          if (all(system%monomials(k)%dof == one%dof) &
              .and. all(system%monomials(k)%power == one%power)) exit
        end do
        numbers(n + k, one%variable) = numbers(n + k, one%variable) + one%coefficient
      end associate
    end do
    n = n + size(system%monomials)
    do i = 1, size(system%laws)
      associate (one => system%laws(i))
        do j = 1, size(one%variables)
          k = one%variables(j)
          numbers(n + i, k) = numbers(n + i, k) + one%weights(j)
        end do
      end associate
    end do
  end subroutine find_numbers

  !> The system without memory. The masses follow its coordinates.
  subroutine unfold_memory(system, whole)
    !> `count_hidden` must not be negative.
    type(polynomial_type), intent(in) :: system
    type(polynomial_type), intent(out) :: whole
    type(dragged_mass), allocatable :: masses(:)
    real(wp) :: share(system%n_memory()), pull(system%n_dof(), system%n_memory())
    integer :: h, i, n, m, total, variables, owner(system%n_memory())

    call find_masses(system, masses)
    n = system%n_dof()
    m = system%n_memory()
    call find_multiples(system, owner, share)
    pull = 0.0_wp
    do i = 1, m
      pull(:, owner(i)) = pull(:, owner(i)) + share(i)*system%spread(:, i)
    end do
    total = n + size(masses)
    variables = m + size(masses)
    allocate (whole%mass(total, total), whole%damping(total, total), source=0.0_wp)
    allocate (whole%gather(variables, total), whole%spread(total, variables), source=0.0_wp)
    allocate (whole%base_direction(total), source=0.0_wp)
    whole%mass(:n, :n) = system%mass
    whole%damping(:n, :n) = system%damping
    whole%base_direction(:n) = system%base_direction
    whole%gather(:m, :n) = system%gather
    whole%spread(:n, :m) = system%spread
    do i = 1, size(masses)
      associate (one => masses(i))
        h = n + i
        whole%mass(h, h) = one%mass
        whole%damping(h, h) = one%mass*one%rate
        whole%damping(:n, h) = -one%mass*one%weight*pull(:, one%variable)
        whole%gather(m + i, :n) = -system%gather(one%variable, :)
        whole%spread(h, m + i) = 1.0_wp
      end associate
    end do
    allocate (whole%kernel_of(variables), source=0)
    whole%bent = [system%bent, system%bent(masses%variable)]
    allocate (whole%kernels(0))
    whole%odd = system%odd
    whole%degree = system%degree
    whole%n_zero = system%n_zero
    whole%n_silent = system%n_silent
    if (allocated(system%shaft)) whole%shaft = system%shaft
    call drag_by_monomials(system, masses, whole)
    call drag_by_laws(system, masses, whole)
  end subroutine unfold_memory

  !> Repeat each hereditary monomial for each of its masses.
  subroutine drag_by_monomials(system, masses, whole)
    type(polynomial_type), intent(in) :: system
    type(dragged_mass), intent(in) :: masses(:)
    type(polynomial_type), intent(inout) :: whole
    integer :: h, i, k

    k = size(system%monomials)
    do i = 1, size(system%monomials)
      k = k + count(masses%variable == system%monomials(i)%variable)
    end do
    allocate (whole%monomials(k))
    whole%monomials(:size(system%monomials)) = system%monomials
    k = size(system%monomials)
    do i = 1, size(system%monomials)
      do h = 1, size(masses)
        if (masses(h)%variable /= system%monomials(i)%variable) cycle
        k = k + 1
        whole%monomials(k) = system%monomials(i)
        whole%monomials(k)%coefficient = -system%monomials(i)%coefficient
        whole%monomials(k)%equation = system%n_dof() + h
        whole%monomials(k)%variable = system%n_memory() + h
      end do
    end do
  end subroutine drag_by_monomials

  !> Apply each law to the masses of its equations as well.
  subroutine drag_by_laws(system, masses, whole)
    type(polynomial_type), intent(in) :: system
    type(dragged_mass), intent(in) :: masses(:)
    type(polynomial_type), intent(inout) :: whole
    integer :: h, i, j, n

    n = system%n_dof()
    whole%laws = system%laws
    do i = 1, size(whole%laws)
      associate (law => whole%laws(i), own => system%laws(i))
        law%kernel = 0
        call widen(law%arguments, n + size(masses))
        call widen(law%rates, n + size(masses))
        do j = 1, size(own%equations)
          do h = 1, size(masses)
            if (masses(h)%variable /= own%variables(j)) cycle
            law%equations = [law%equations, n + h]
            law%weights = [law%weights, -own%weights(j)]
            law%variables = [law%variables, system%n_memory() + h]
          end do
        end do
      end associate
    end do
    call read_rates(whole%laws, n + size(masses), whole%rates)
  end subroutine drag_by_laws

  !> Append zero columns to a matrix.
  subroutine widen(matrix, n)
    real(wp), allocatable, intent(inout) :: matrix(:, :)
    integer, intent(in) :: n
    real(wp) :: wide(size(matrix, 1), n)
    wide = 0.0_wp
    wide(:, :size(matrix, 2)) = matrix
    matrix = wide
  end subroutine widen

end module viscovib_hidden_memory
